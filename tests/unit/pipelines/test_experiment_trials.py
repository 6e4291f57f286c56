"""Measurements over the number of trials, with a small MDE and a few trials."""

from pathlib import Path

import numpy as np
import pytest

from common.domain.case import Case
from common.storage.cases import write_case
from common.storage.dataset import Dataset
from pipelines.experiments.finetunings import find_weights, finetune_once
from pipelines.experiments.measurements import measure
from pipelines.experiments.parameters import ActiveChoice, Cases, Finetuned, OnCases, SampleSize
from pipelines.experiments.place import Place
from pipelines.experiments.raw import FILE, Raw, read_raw
from pipelines.mde.finetune import FinetuneSettings
from tests.mde_fakes import write_dataset, write_weights

TRIALS, TESTS = Cases(trials=("real/train",)), Cases(trials=("real/test",))
WEIGHTS = {"mde_heuristic": "small/mde_heuristic"}


@pytest.fixture(scope="module")
def place(tmp_path_factory: pytest.TempPathFactory) -> Place:
    """Return a released MDE of the heuristic, 24 trials to learn from and 8 to judge."""
    folder = tmp_path_factory.mktemp("place")
    dataset = write_dataset(folder / "small")
    write_weights(folder / "models" / WEIGHTS["mde_heuristic"], dataset)
    write_trials(folder / "data" / "real" / "train", dataset, "train", 24)
    write_trials(folder / "data" / "real" / "test", dataset, "test", 8)
    return Place(folder / "models", folder / "data", folder / "raw")


def write_trials(folder: Path, dataset: Dataset, split: str, count: int) -> None:
    """Write samples as trials of a world in which items sink by half."""
    assert split in ("train", "test")
    folder.mkdir(parents=True)
    samples = dataset.samples(split)
    for index in range(count):
        state = dataset.state(split, int(samples.groups[index]))
        sunk = state.scene.heights + 0.5 * (samples.outcomes[index] - state.scene.heights)
        x, y = samples.actions[index].tolist()
        write_case(folder / f"{index:03d}.npz", Case(f"{split}-{index}", 0, state, sunk, (x, y), same_item=True))


def measured(parameters: SampleSize | ActiveChoice, place: Place) -> Raw:
    return read_raw(measure(parameters, place, lambda done, total: None) / FILE)


def error(raw: Raw, method: str, trials: int) -> float:
    rows = [row for row in raw.rows if (row["method"], row["trials"]) == (method, trials)]
    return float(np.mean([abs(row["mean"] - row["truth"]) for row in rows]))


def test_more_trials_of_another_world_make_a_pretrained_mde_better(place: Place):
    parameters = SampleSize(
        cases=TESTS,
        trials=TRIALS,
        model="heuristic",
        weights=WEIGHTS,
        counts=(6, 24),
        methods=("last", "calibration"),
        trainings=(0, 1),
    )
    raw = measured(parameters, place)
    assert raw.is_complete
    assert len(raw.rows) == 8 * (2 + 2 * 2 * 2)
    assert raw.header["seeds"] == [0, 1]
    assert error(raw, "last", 24) < error(raw, "s2s", 0)
    assert error(raw, "calibration", 24) < error(raw, "s2s", 0)
    assert len({row["truth"] for row in raw.rows if row["sample"] == 3}) == 1


def test_chosen_trials_begin_with_those_that_chance_begins_with(place: Place):
    parameters = ActiveChoice(
        cases=TESTS,
        trials=TRIALS,
        model="heuristic",
        weights=WEIGHTS,
        counts=(4, 8, 24),
        acquisitions=("random", "integrated"),
        first=4,
        trainings=(0,),
    )
    raw = measured(parameters, place)
    found = {
        (method, trials): [row["mean"] for row in raw.rows if (row["method"], row["trials"]) == (method, trials)]
        for method in ("random", "integrated")
        for trials in (4, 8, 24)
    }
    assert found["random", 4] == found["integrated", 4]
    assert found["random", 8] != found["integrated", 8]
    np.testing.assert_allclose(found["random", 24], found["integrated", 24])  # all of them, in another order


def test_an_mde_is_fine_tuned_once_and_again_for_other_trials(place: Place, tmp_path: Path):
    parameters = OnCases(
        kind="any",
        cases=TESTS,
        weights=WEIGHTS,
        finetuned=Finetuned(trials=TRIALS, bases=WEIGHTS, method="calibration"),
    )
    folder = find_weights(parameters, place)["mde_heuristic"]
    written = (folder / "card.json").stat().st_mtime_ns
    assert folder.is_relative_to(place.raw)
    assert find_weights(parameters, place)["mde_heuristic"] == folder
    assert (folder / "card.json").stat().st_mtime_ns == written
    settings = FinetuneSettings(method="calibration")
    base = place.models / WEIGHTS["mde_heuristic"]
    finetune_once(place, "heuristic", TESTS, base, folder, settings, {})
    assert (folder / "card.json").stat().st_mtime_ns != written
