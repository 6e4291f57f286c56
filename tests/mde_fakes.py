"""A small data set without a simulator, and an MDE trained on it in a few seconds."""

from functools import cache
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from common.domain.case import Case
from common.domain.grid import Floats, Grid
from common.domain.scene import State
from common.learning.training import TrainingSettings
from common.learning.weights import WeightsCard
from common.storage.dataset import Dataset
from common.storage.dataset_card import DatasetPlan, GridCard
from common.storage.dataset_record import StateSamples
from common.storage.dataset_writer import DatasetWriter
from pipelines.data.sample import make_state
from pipelines.mde.examples import deviation_scale, model_deviations
from pipelines.mde.release import release
from pipelines.mde.train import EnsembleSettings
from services.heuristic import HeuristicModel

GRID = Grid(64, 64, 0.0045)
SMALL: dict[str, dict[str, object]] = {
    "crop": {"channels": (8, 8, 12, 16), "features": 8},
    "paper": {"channels": (4, 8, 8, 8), "embedding": 16, "width": 16},
}
"""Sizes of the networks in tests."""


class Sinking(HeuristicModel):
    """Stands for the simulator: the item loses a part of its thickness, more where it lies on fries."""

    name = "simulator"

    def outcomes(self, state: State, actions: NDArray[np.float64]) -> tuple[Floats, tuple[str, ...]]:
        heights, warnings = super().outcomes(state, actions)
        added = heights - state.scene.heights
        return state.scene.heights + added * np.where(state.scene.materials[0] > 0, 0.4, 0.9), warnings


def small_settings(variant: str = "crop", *, members: int = 2, epochs: int = 2, seed: int = 0) -> EnsembleSettings:
    training = TrainingSettings(epochs=epochs, batch=8, learning_rate=3e-3, patience=epochs, threads=1, seed=seed)
    return EnsembleSettings(variant=variant, network=SMALL[variant], members=members, training=training)


def make_trials(count: int, *, first: int = 0, shift_m: float = 0.0, share: float = 1.0) -> list[Case]:
    """Return trials in a world that adds a share of what `Sinking` adds, and lifts everything by `shift_m` [m]."""
    cases: list[Case] = []
    for index in range(first, first + count):
        made = _drawn("test", 1000 + index)
        assert made.state is not None
        scene = made.state.scene.heights
        outcome = scene + share * (made.outcomes[0] - scene) + np.float32(shift_m)
        cases.append(Case(f"trial-{index}", index, made.state, outcome, tuple(made.actions[0].tolist()), True))
    return cases


@cache
def _drawn(split: str, index: int) -> StateSamples:
    return make_state(_plan(), split, index, settle=lambda plate, boxes: tuple(boxes), model=Sinking())


def _plan(train: int = 32, test: int = 8) -> DatasetPlan:
    return DatasetPlan(
        name="small",
        seed=5,
        preset="wide",
        counts={"train": train, "test": test},
        actions_per_state=2,
        grid=GridCard(rows=GRID.rows, columns=GRID.columns, cell=GRID.cell),
        model="simulator",
        version="1",
        level="default",
        settings={"friction": 0.5},
    )


def write_dataset(folder: Path) -> Dataset:
    """Write 32 training and 8 test samples of 16 and 4 states and return them."""
    plan = _plan()
    with DatasetWriter(folder, plan) as writer:
        for split, count in plan.counts.items():
            for index in range(count // plan.actions_per_state):
                writer.add(split, _drawn(split, index))
        return writer.finish()


def write_weights(folder: Path, dataset: Dataset, settings: EnsembleSettings | None = None) -> WeightsCard:
    """Train an MDE of the heuristic model and return its card."""
    return release(
        dataset,
        "heuristic",
        model_deviations(dataset, "train", HeuristicModel()),
        folder,
        settings or small_settings(),
        model_version="1",
        scale_m=deviation_scale(dataset),
    )
