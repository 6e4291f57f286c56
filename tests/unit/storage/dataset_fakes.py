"""Small data sets without a simulator: fries stay where they were drawn, outcomes are sums."""

from pathlib import Path

import numpy as np

from common.domain.errors import ModelError
from common.domain.grid import Grid
from common.storage.dataset_card import DatasetPlan, GridCard
from common.storage.dataset_writer import DatasetWriter
from pipelines.data.sample import make_state
from services.heuristic import HeuristicModel

GRID = Grid(48, 50, 0.006)


def as_drawn(plate, boxes):
    return tuple(boxes)


def plan(**changes):
    values = {
        "name": "small",
        "seed": 3,
        "preset": "wide",
        "counts": {"train": 5, "test": 2},
        "actions_per_state": 2,
        "grid": GridCard(rows=GRID.rows, columns=GRID.columns, cell=GRID.cell),
        "model": "heuristic",
        "version": "1",
        "level": "default",
        "settings": {"friction": 0.5},
    }
    return DatasetPlan.model_validate(values | changes)


class Restless(HeuristicModel):
    """Does not come to rest on the left, and fails at the top."""

    def outcomes(self, state, actions):
        heights, _ = super().outcomes(state, actions)
        if (actions[:, 1] > 0.03).any():
            raise ModelError("the solver diverged")
        return heights, tuple("not_settled: 5 mm/s" if x < 0 else "" for x, _ in actions)


def made(split, index, *, model=None, of=None):
    """Return state ``index`` of a split with its samples."""
    return make_state(of or plan(), split, index, settle=as_drawn, model=model or HeuristicModel())


def write(path, *, model=None, of=None, order=None):
    """Write a data set state by state, in the given order of the states, and return it."""
    of = of or plan()
    with DatasetWriter(path, of) as writer:
        for split, count in of.counts.items():
            states = list(range(12 if model else -(-count // of.actions_per_state)))
            for index in order(states) if order else states:
                writer.add(split, made(split, index, model=model, of=of))
        return writer.finish()


def contents(path: Path) -> dict[str, bytes]:
    """Return all folders and the bytes of all files, but not the measured times."""
    return {
        str(found.relative_to(path)): found.read_bytes() if found.is_file() else b""
        for found in sorted(path.rglob("*"))
        if found.name != "timings.jsonl"
    }


def same(first: np.ndarray, second: np.ndarray) -> bool:
    return first.dtype == second.dtype and np.array_equal(first, second, equal_nan=True)
