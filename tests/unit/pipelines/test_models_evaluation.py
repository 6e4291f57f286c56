"""Table I: raw measurements, parts, and what the table makes of them."""

from pathlib import Path

import numpy as np
import pytest

from common.domain.grid import Grid
from common.storage.dataset import Dataset
from pipelines.evaluate.models import models_table
from pipelines.evaluate.models_runs import (
    BATCH,
    Latency,
    Measurement,
    measure,
    measure_pair,
    read_rows,
    time_batches,
    write_rows,
)
from pipelines.evaluate.regions import region
from services.heuristic import HeuristicModel
from tests.mde_fakes import Sinking, write_dataset

GRID = Grid(96, 96, 0.003)
ITEM = np.where(np.hypot(GRID.x[None, :], GRID.y[:, None]) < 0.03, 0.02, 0.0)


@pytest.fixture(scope="module")
def dataset(tmp_path_factory: pytest.TempPathFactory) -> Dataset:
    return write_dataset(tmp_path_factory.mktemp("data") / "small")


def row(model: str, sample: int, rmse_m: float, **changes: object) -> Measurement:
    values = {
        "model": model,
        "version": "1",
        "reference": "data",
        "sample": sample,
        "group": sample // 2,
        "region": "flat",
        "rigid": False,
        "rmse_m": rmse_m,
    }
    return Measurement(**(values | changes))  # type: ignore[arg-type]


@pytest.mark.parametrize(
    ("action", "fry_at", "expected"),
    [
        ((0.0, 0.0), (0.06, 0.0), "flat"),
        ((0.04, 0.0), (0.06, 0.0), "fries"),
        ((0.0, 0.07), (0.06, 0.0), "rim"),
        ((0.06, 0.0), (0.06, 0.0), "fries_and_rim"),
    ],
)
def test_the_region_is_what_lies_below_the_item(action: tuple, fry_at: tuple, expected: str):
    near = np.hypot(GRID.x[None, :] - fry_at[0], GRID.y[:, None] - fry_at[1]) < 0.012
    materials = np.where(near, np.array([550.0, 1e6, 0.3])[:, None, None], 0.0)
    assert region(GRID, materials, ITEM, np.array(action)) == expected


def test_the_heuristic_is_measured_against_every_outcome(dataset: Dataset):
    samples = dataset.samples("test")
    rows = measure(HeuristicModel(), dataset, samples)
    assert [one.sample for one in rows] == list(range(len(samples)))
    for one in rows:
        state = dataset.state("test", one.group)
        predicted = HeuristicModel().predict(state, samples.actions[one.sample][None]).heights[0]
        expected = np.sqrt(((predicted.astype(float) - samples.outcomes[one.sample]) ** 2).mean())
        assert one.rmse_m == pytest.approx(expected)
        assert one.rigid == samples.rigid[one.sample]
    assert rows == measure(HeuristicModel(), dataset, samples)


def test_a_model_can_be_measured_against_another(dataset: Dataset):
    samples = dataset.samples("test")
    rows = measure_pair(Sinking(), HeuristicModel(), dataset, samples, count=3)
    assert [one.sample for one in rows] == [0, 4, 7]
    against_data = {one.sample: one.rmse_m for one in measure(HeuristicModel(), dataset, samples)}
    for one in rows:
        assert one.rmse_m == pytest.approx(against_data[one.sample])
        assert (one.model, one.reference) == ("simulator", "heuristic")
        assert one.time_s is not None
        assert one.time_s > 0


def test_times_are_of_one_prediction_in_a_batch(dataset: Dataset):
    latency = time_batches(HeuristicModel(), dataset, dataset.samples("test"), states=3)
    assert (latency.model, latency.batch, len(latency.times_s)) == ("heuristic", BATCH, 3)
    assert min(latency.times_s) > 0


def test_the_table_has_means_spreads_and_ratios_by_part():
    rows = [
        row("heuristic", 0, 0.002),
        row("heuristic", 1, 0.004, rigid=True, region="fries"),
        row("learned", 0, 0.001),
        row("learned", 1, 0.001, rigid=True, region="fries"),
        row("simulator", 1, 0.0005, rigid=True, region="fries", reference="simulator_fine", time_s=0.3),
        Latency("learned", 8, tuple(0.001 * k for k in range(1, 102))),
    ]
    table = models_table(rows)
    heuristic, learned, simulator = (table[name] for name in ("heuristic", "learned", "simulator"))
    assert (heuristic["rmse_m"], heuristic["rmse_std_m"]) == (pytest.approx(0.003), pytest.approx(0.001))
    assert learned["ratio"] == pytest.approx(1 / 3)
    assert learned["parts"]["rigid"]["ratio"] == pytest.approx(0.25)
    assert learned["parts"]["flat"]["rmse_m"] == pytest.approx(0.001)
    assert learned["parts"]["rim"] == {
        "rmse_m": None,
        "rmse_std_m": None,
        "rmse_median_m": None,
        "samples": 0,
        "ratio": None,
    }
    assert learned["latency_p50_s"] == pytest.approx(0.051)
    assert learned["latency_p95_s"] == pytest.approx(0.096)
    assert heuristic["latency_p50_s"] is None
    assert (simulator["reference"], simulator["ratio"]) == ("simulator_fine", pytest.approx(0.125))
    assert (simulator["latency_p50_s"], simulator["latency_batch"]) == (0.3, 1)


def test_raw_results_survive_the_disk(dataset: Dataset, tmp_path: Path):
    samples = dataset.samples("test")
    rows = [
        *measure_pair(Sinking(), HeuristicModel(), dataset, samples, count=2),
        time_batches(HeuristicModel(), dataset, samples, states=1),
    ]
    write_rows(tmp_path / "out" / "rows.jsonl", rows)
    assert list(read_rows(tmp_path / "out" / "rows.jsonl")) == rows
