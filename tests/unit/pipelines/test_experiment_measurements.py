"""What measurements write, with cheap models."""

from pathlib import Path

import numpy as np
import pytest

from common.domain.errors import RequestError
from common.storage.cases import read_case
from pipelines.experiments.arrays import pack, unpack
from pipelines.experiments.case_sets import TrialCases, find_cases
from pipelines.experiments.measure_examples import first_of_regions
from pipelines.experiments.measurements import measure
from pipelines.experiments.parameters import Cases, Examples, ModelErrors
from pipelines.experiments.place import Place
from pipelines.experiments.raw import FILE, read_raw
from services.heuristic import HeuristicModel

SCENES = sorted((Path(__file__).parents[3] / "examples" / "scenes").glob("*.npz"))


@pytest.fixture
def place(tmp_path: Path) -> Place:
    """The bundled scenes as trials in two folders."""
    for index, path in enumerate(SCENES[:6]):
        folder = tmp_path / "data" / "bundled" / ("test" if index < 4 else "more")
        folder.mkdir(parents=True, exist_ok=True)
        (folder / path.name).symlink_to(path)
    return Place(tmp_path / "models", tmp_path / "data", tmp_path / "raw")


ALL = Cases(trials=("bundled/test", "bundled/more"))


def test_trials_of_several_folders_are_one_set_with_a_digest(place: Place):
    cases = find_cases(place.data, ALL)
    assert len(cases) == 6
    assert [cases.case(index).name for index in (0, 5)] == [read_case(SCENES[index]).name for index in (0, 5)]
    spread = TrialCases(place.data, Cases(trials=ALL.trials, count=3))
    assert [spread.case(index).name for index in range(3)] == [cases.case(index).name for index in (0, 2, 5)]
    assert cases.about()["sha256"] != spread.about()["sha256"]
    with pytest.raises(RequestError, match="expected 7 cases, got 6"):
        find_cases(place.data, Cases(trials=ALL.trials, count=7))
    with pytest.raises(RequestError, match="expected trials"):
        find_cases(place.data, Cases(trials=("bundled/nothing",)))


def test_the_error_of_a_model_is_its_distance_from_the_outcome(place: Place):
    parameters = ModelErrors(cases=ALL, models=("heuristic",))
    found = read_raw(measure(parameters, place, lambda done, total: None) / FILE)
    assert found.is_complete
    assert found.header["cases"]["name"] == "bundled/test, bundled/more"
    assert [row["sample"] for row in found.rows] == list(range(6))
    case, row = read_case(SCENES[0]), found.rows[0]
    assert case.true_action is not None

    heights = HeuristicModel().predict(case.state, np.array([case.true_action])).heights[0]
    assert row["rmse_m"] == pytest.approx(float(np.sqrt(((heights.astype(float) - case.target) ** 2).mean())))
    assert row["rigid"] == case.state.item.is_rigid
    assert 0 < row["time_s"] < 1


def test_an_example_holds_what_is_drawn(place: Place):
    cases = find_cases(place.data, ALL)
    (index,) = first_of_regions(cases, ("flat",))
    assert index == 3
    parameters = Examples(cases=ALL, family=("heuristic",), method="only:heuristic", regions=("flat",), evaluations=4)
    (row,) = read_raw(measure(parameters, place, lambda done, total: None) / FILE).rows
    case = cases.case(index)
    assert row["case"] == case.name
    np.testing.assert_array_equal(unpack(row["target"]), case.target)
    assert len(row["trials"]) == 4
    assert unpack(row["achieved"]).shape == case.target.shape


def test_a_region_without_a_target_is_told_of(place: Place):
    with pytest.raises(RequestError, match="expected a target of the region rim, got none among 6"):
        first_of_regions(find_cases(place.data, ALL), ("flat", "rim"))


def test_heightmaps_survive_packing():
    heights = np.random.default_rng(0).normal(size=(5, 7)).astype(np.float32)
    np.testing.assert_array_equal(unpack(pack(heights)), heights)
