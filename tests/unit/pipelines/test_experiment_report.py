"""The report and its JSON say the same."""

import json
import re
from pathlib import Path

import pytest

from common.domain.errors import RequestError
from pipelines.experiments.experiment import read_experiments
from pipelines.experiments.measurements import find_raw
from pipelines.experiments.numbers import written
from pipelines.experiments.raw import FILE
from pipelines.experiments.report import Section, as_json, make_sections, write_report
from pipelines.experiments.views import VIEWS
from tests.unit.pipelines.experiments_fakes import results

EXPERIMENTS = read_experiments()
NUMBER = re.compile(r"(?<![\w:/-])-?\d+(?:\.\d+)?")


@pytest.fixture(scope="module")
def raw_folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Made-up raw results of all experiments on disk."""
    folder = tmp_path_factory.mktemp("raw")
    for experiment in EXPERIMENTS:
        for name, found in results(experiment).items():
            path = folder / experiment.measurements[name].folder / FILE
            path.parent.mkdir(exist_ok=True)
            lines = [{"measurement": found.header}, *found.rows]
            path.write_text("".join(json.dumps(line) + "\n" for line in lines))
    return folder


@pytest.fixture(scope="module")
def sections(raw_folder: Path) -> tuple[Section, ...]:
    return make_sections(EXPERIMENTS, raw_folder)


def cells(text: str) -> list[str]:
    rows = [line.split("|")[2:-1] for line in text.splitlines() if line.startswith("|") and not line.startswith("|--")]
    return [cell for row in rows for cell in row]


def test_every_number_in_a_table_is_in_the_json(sections: tuple[Section, ...], tmp_path: Path):
    document = write_report(sections, tmp_path).read_text()
    known: set[str] = set()
    for one in json.loads(json.dumps(as_json(sections))):
        known |= {written(one[name]) for name in ("value", "low", "high", "std") if one[name] is not None}
        known |= {str(one["samples"]), *NUMBER.findall(one["column"])}
        if one["paper"]:
            known |= {f"{one['paper'][name]:g}" for name in ("value", "std") if one["paper"][name] is not None}
            known |= set(NUMBER.findall(one["paper"]["text"]))
    printed = {number for cell in cells(document) for number in NUMBER.findall(cell.replace("cm^2", "cm"))}
    assert len(printed) > 50
    assert printed <= known


def test_a_number_has_seeds_samples_interval_and_the_papers_value(sections: tuple[Section, ...]):
    numbers = {(one["experiment"], one["key"]): one for one in as_json(sections)}
    one = numbers["table1", "sim.heuristic"]
    assert one["paper"] == {"value": 1.7558, "std": 0.5474, "unit": "cm^2", "text": "", "where": "Table I"}
    assert (one["seeds"], one["samples"]) == ([0], 4)
    assert one["low"] < one["value"] < one["high"]
    assert numbers["sim_error_time", "ours.error"]["paper"] is None  # the paper draws a bar
    assert numbers["sim_error_time", "ours.time"]["paper"]["text"] == "around 15 s"


def test_the_document_has_every_experiment_with_figure_and_raw_results(sections: tuple[Section, ...], tmp_path: Path):
    path = write_report(sections, tmp_path)
    document = path.read_text()
    places = [document.index(f"## {one.of}: {one.title}") for one in EXPERIMENTS]
    assert places == sorted(places)
    for link in re.findall(r"\]\((figures/[^)]+)\)", document):
        assert (tmp_path / link).read_bytes().startswith(b"\x89PNG")
    assert EXPERIMENTS[0].measurements["sim"].folder in document
    assert "{" not in document
    assert "*paper: 1.7558 (0.5474) cm^2*" in document


def test_missing_raw_results_name_the_command_and_partial_leaves_them_out(raw_folder: Path, tmp_path: Path):
    experiment = EXPERIMENTS[0]
    with pytest.raises(RequestError, match=f"{experiment.name}: expected raw results in .* run `frugal evaluate"):
        make_sections([experiment], tmp_path)
    (section,) = make_sections([experiment], tmp_path, partial=True)
    assert section.shown is None
    assert as_json([section]) == []
    assert f"Not measured: `frugal evaluate {experiment.name}`" in write_report([section], tmp_path).read_text()


def test_incomplete_raw_results_are_missing(raw_folder: Path, tmp_path: Path):
    experiment = next(one for one in EXPERIMENTS if one.name == "sim_usage")
    path = tmp_path / experiment.measurements["optimise"].folder / FILE
    path.parent.mkdir()
    lines = (raw_folder / path.parent.name / FILE).read_text().splitlines(keepends=True)
    path.write_text("".join(lines[:-1]))
    with pytest.raises(RequestError, match=r"expected 45 rows in .*, got 44: run `frugal evaluate sim_usage`"):
        find_raw(experiment, tmp_path)


def test_an_experiment_that_all_leaves_out_is_not_missed(raw_folder: Path, tmp_path: Path):
    fine = EXPERIMENTS[-1].model_copy(update={"in_all": False})
    (section,) = make_sections([fine], tmp_path)
    assert section.shown is None
    assert VIEWS[fine.view](fine, results(fine)).numbers
