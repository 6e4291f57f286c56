"""The files of the paper's experiments."""

import re
from pathlib import Path

import pytest

from common.domain.errors import RequestError
from pipelines.evaluate.strategies_methods import parse_contender
from pipelines.experiments.experiment import FOLDER, read_experiment, read_experiments
from pipelines.experiments.measurements import MEASUREMENTS
from pipelines.experiments.numbers import PLACEHOLDER
from pipelines.experiments.parameters import Optimisations
from pipelines.experiments.views import VIEWS
from tests.unit.pipelines.experiments_fakes import results

FILES = sorted(FOLDER.glob("*.toml"))


@pytest.mark.parametrize("path", FILES, ids=lambda path: path.stem)
def test_every_file_names_a_view_measurements_and_methods_that_exist(path: Path):
    experiment = read_experiment(path)
    assert experiment.view in VIEWS
    for parameters in experiment.measurements.values():
        assert parameters.kind in MEASUREMENTS
        if isinstance(parameters, Optimisations):
            for method in parameters.methods:
                parse_contender(method, trusted=parameters.family[-1])


@pytest.mark.parametrize("path", FILES, ids=lambda path: path.stem)
def test_the_papers_values_and_the_notes_are_about_numbers_that_the_view_makes(path: Path):
    experiment = read_experiment(path)
    shown = VIEWS[experiment.view](experiment, results(experiment))
    keys = [one.key for one in shown.numbers]
    assert len(keys) == len(set(keys))
    assert {one.key for one in experiment.paper} <= set(keys)
    assert set(PLACEHOLDER.findall(experiment.about + experiment.note)) <= set(keys)


@pytest.mark.parametrize("path", FILES, ids=lambda path: path.stem)
def test_prose_has_no_number_of_its_own(path: Path):
    experiment = read_experiment(path)
    prose = PLACEHOLDER.sub("", experiment.title + experiment.about + experiment.note)
    assert re.findall(r"(?<![\w])\d[\d.]*", prose) == []


def test_experiments_come_in_the_order_of_the_report():
    found = read_experiments()
    assert [one.name for one in found[:2]] == ["table1", "table2"]
    assert [one.order for one in found] == sorted({one.order for one in found})
    assert all(one.in_all for one in found)


def test_figures_of_one_comparison_share_its_raw_results():
    found = {one.name: one for one in read_experiments()}
    for first, second in (("sim_error_time", "sim_usage"), ("real_error_time", "real_usage")):
        assert found[first].measurements == found[second].measurements
    assert found["sim_error_time"].measurements["optimise"].folder != found["sim_fine"].measurements["optimise"].folder


def test_a_default_that_is_written_out_makes_no_other_folder(tmp_path: Path):
    text = (FOLDER / "sim_error_time.toml").read_text()
    (tmp_path / "a.toml").write_text(text)
    (tmp_path / "b.toml").write_text(text.replace('kind = "optimise"', 'kind = "optimise"\nevaluations = 50\nseed = 0'))
    (tmp_path / "c.toml").write_text(text.replace('kind = "optimise"', 'kind = "optimise"\nevaluations = 49'))
    a, b, c = (read_experiment(path).measurements["optimise"].folder for path in sorted(tmp_path.glob("*.toml")))
    assert a == b != c
    assert re.fullmatch(r"optimise-[0-9a-f]{10}", a)


@pytest.mark.parametrize(
    ("old", "new", "expected"),
    [
        ("order =", "colour =", "order: Field required"),
        ("order = 4", "order = 4\ncolour = 1", "colour: Extra inputs are not permitted, got 1"),
        ('kind = "optimise"', 'kind = "optimize"', "measurements.optimise: Input tag 'optimize'"),
        (
            'data = "narrow-v1", ',
            "",
            "optimise.cases: Value error, expected either data or trials",
        ),
        ('method = "only:learned"', 'method = "only:learned"\nmeasurement = "x"', "expected a measurement of optimise"),
        ("order = 4", "order =", "expected TOML"),
    ],
)
def test_a_file_that_is_wrong_is_refused_in_one_line(old: str, new: str, expected: str, tmp_path: Path):
    text = (FOLDER / "sim_error_time.toml").read_text()
    assert old in text
    (tmp_path / "wrong.toml").write_text(text.replace(old, new, 1))
    with pytest.raises(RequestError) as error:
        read_experiment(tmp_path / "wrong.toml")
    assert expected in str(error.value)
    assert "wrong.toml" in str(error.value)
    assert "\n" not in str(error.value)


def test_a_folder_without_experiments_is_refused(tmp_path: Path):
    with pytest.raises(RequestError, match="expected experiments"):
        read_experiments(tmp_path)
