"""A small state, and models and estimators that do as they are told."""

import threading
from collections.abc import Callable
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from common.domain.deviation import DeviationEstimator, Estimates
from common.domain.grid import Floats, Grid
from common.domain.heightmap import shift
from common.domain.model import Event, Predictions, PredictiveModel
from common.domain.scene import Item, Scene, State
from common.planning.problem import Problem
from common.tasks.plating import Plating

GRID = Grid(24, 24, 0.006)
TRUE_ACTION = (0.021, -0.013)


def small_state() -> State:
    x, y = GRID.x[None, :], GRID.y[:, None]
    scene = np.where(np.hypot(x, y) < 0.06, 0.0, 0.01) + 0.01 * np.exp(-((x - 0.02) ** 2 + y**2) / 2e-4)
    item = 0.015 * np.exp(-((x / 0.02) ** 2 + (y / 0.03) ** 2))
    item[item < 0.003] = 0
    materials = np.where(item > 0, np.array([1000.0, 3e4, 0.4])[:, None, None], 0)
    return State(Scene(GRID, scene, np.zeros((3, *GRID.shape))), Item(item, materials))


def small_problem() -> Problem:
    state = small_state()
    target = state.scene.heights + shift(state.item.heights, *(np.array(TRUE_ACTION) / GRID.cell))
    return Problem(Plating(), state, target)


@dataclass
class FakeModel(PredictiveModel):
    """The sum of scene and shifted item; calls are counted, ``error`` raised in calls ``fails``, ``wait`` called."""

    name: str = "simulator"
    version: str = "3"
    error: Exception | None = None
    fails: Callable[[int], bool] = lambda call: True
    wait: Callable[[int], object] = lambda call: None
    warning: str = ""
    events: tuple[Event, ...] = ()
    compute_s: float | None = None
    calls: int = 0
    lock: threading.Lock = field(default_factory=threading.Lock)

    def outcomes(self, state: State, actions: NDArray[np.float64]) -> tuple[Floats, tuple[str, ...]]:
        with self.lock:
            call, self.calls = self.calls, self.calls + 1
        self.wait(call)
        if self.error is not None and self.fails(call):
            raise self.error
        moved = np.stack([shift(state.item.heights, *(action / GRID.cell)) for action in actions])
        return state.scene.heights + moved, (self.warning,) * len(actions)

    def predict(self, state: State, actions: Floats) -> Predictions:
        return replace(super().predict(state, actions), events=self.events, compute_s=self.compute_s)


@dataclass
class FakeEstimator(DeviationEstimator):
    """The same estimate for every action, or one that grows with x."""

    model: str = "heuristic"
    version: str = "1"
    mean: Callable[[float], float] = lambda x: 0.1
    margin: float = 0.0
    familiar: bool = True
    error: Exception | None = None
    calls: int = 0

    def deviations(self, state: State, actions: NDArray[np.float64]) -> Estimates:
        self.calls += 1
        if self.error is not None:
            raise self.error
        mean = np.array([self.mean(float(action[0])) for action in actions])
        return Estimates(mean, mean + self.margin, np.full(len(actions), self.familiar))
