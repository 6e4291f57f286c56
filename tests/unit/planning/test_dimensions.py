"""Planning in 1 to 6 parameters of different units, on functions whose best action is known."""

from dataclasses import dataclass

import numpy as np
import pytest
from numpy.typing import NDArray

from common.domain.grid import Floats, Grid
from common.domain.model import PredictiveModel
from common.domain.parameter import Parameter
from common.domain.scene import Item, Scene, State
from common.domain.task import Task
from common.domain.transport import Transport, Window
from common.planning.optimize import optimize
from common.planning.planner import Planner
from common.planning.problem import Problem
from common.planning.space import Space

GRID = Grid(2, 2, 0.01)
RANGES = np.array([0.16, 0.16, 2 * np.pi, 40.0, 0.002, 3000.0])
MATERIALS = np.ones((3, 2, 2)) * 0.1
STATE = State(Scene(GRID, np.zeros((2, 2)), np.zeros((3, 2, 2))), Item(np.full((2, 2), 0.01), MATERIALS))
PEAK = np.array([0.21, -0.33, 0.49, -0.12, 0.27, -0.4])
"""The best action as shares of the ranges; that of the third parameter, a circle, lies at the seam of its bounds."""
OTHER = np.array([-0.3, 0.2, 0.05, 0.3, -0.2, 0.1])
"""A second basin, less deep."""


@dataclass
class Basins(Task):
    """Actions of n parameters; the outcome's height is how far an action is from the best one."""

    dimensions: int
    name: str = "basins"
    trusted: str = "simulator"

    def __post_init__(self) -> None:
        circle = Parameter("angle", "rad", period=2 * np.pi)
        plain = [Parameter(f"p{index}", "m") for index in range(6)]
        self.parameters = tuple([*plain[:2], circle, *plain[3:]][: self.dimensions])

    def bounds(self, state: State) -> NDArray[np.float64]:
        half = RANGES[: self.dimensions] / 2
        return np.stack([-half, half], axis=1)

    def transport(self, state: State, action: NDArray[np.float64], outcome: Floats) -> Transport:
        return Nearby(self.dimensions, action)


def distance(actions: NDArray[np.float64], places: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return distances ``(B,)`` as shares of the ranges, round the circle."""
    gaps = actions / RANGES[: actions.shape[1]] - places[: actions.shape[1]]
    if actions.shape[1] > 2:
        gaps[:, 2] = (gaps[:, 2] + 0.5) % 1 - 0.5
    return np.linalg.norm(gaps, axis=1)


def depth(actions: NDArray[np.float64], peak: NDArray[np.float64] = PEAK) -> NDArray[np.float64]:
    """Return how far from best actions ``(B, n)`` are ``(B,)`` [m]: two cones, the deeper one at the peak."""
    return 0.01 * np.minimum(distance(actions, peak), 0.15 + distance(actions, OTHER))


class Nearby(Transport):
    """Knows the depth but for a ripple, whose height at the known action it takes to be the same everywhere."""

    def __init__(self, dimensions: int, action: NDArray[np.float64]) -> None:
        self._action = action / RANGES[:dimensions]
        self.outcome = heightmaps(depth(action[None]))[0]

    def window(self, actions: NDArray[np.float64]) -> Window:
        return slice(0, 2), slice(0, 2)

    def patches(self, actions: NDArray[np.float64], window: Window, shared: object = None) -> NDArray[np.float32]:
        ripple = np.sin(8 * actions[:, 0] / RANGES[0]) - np.sin(8 * self._action[0])
        return heightmaps(depth(actions) + 1e-4 * ripple)

    def distances(self, actions: NDArray[np.float64]) -> NDArray[np.float64]:
        return 0.16 * distance(actions, self._action)

    def aligned(self) -> NDArray[np.float32]:
        return np.full(4, -1e-4 * np.sin(8 * self._action[0]), dtype=np.float32)


def heightmaps(heights: NDArray[np.float64]) -> NDArray[np.float32]:
    return np.broadcast_to(heights[:, None, None], (len(heights), 2, 2)).astype(np.float32)


class Cones(PredictiveModel):
    """The depth as a constant heightmap; a cheap one has its peak elsewhere, by 4 % of every range."""

    version = "1"
    largest_batch = 4096
    takes = ()

    def __init__(self, name: str, *, shift: float = 0.0) -> None:
        self.name = name
        self._shift = shift

    def outcomes(self, state: State, actions: NDArray[np.float64]) -> tuple[Floats, tuple[str, ...]]:
        return heightmaps(depth(actions, PEAK + self._shift) + 0.05 * self._shift), ("",) * len(actions)


def solve(dimensions: int, strategy: str, **options) -> float:
    """Return how far the answer is from the best action, as a share of the ranges."""
    problem = Problem(Basins(dimensions), STATE, np.zeros((2, 2), dtype=np.float32))
    models = {"cheap": Cones("cheap", shift=0.04), "simulator": Cones("simulator")}
    result = optimize(problem, models, {}, strategy=strategy, **options)
    return float(distance(np.array([result.action]), PEAK)[0])


@pytest.mark.parametrize(
    ("dimensions", "evaluations", "tolerance"), [(1, 20, 0.002), (2, 50, 0.005), (3, 60, 0.01), (6, 90, 0.03)]
)
def test_gp_ucb_finds_the_deeper_basin_across_the_seam(dimensions: int, evaluations: int, tolerance: float):
    for seed in range(2):
        assert solve(dimensions, "only:simulator", evaluations=evaluations, seed=seed) < tolerance


@pytest.mark.parametrize("dimensions", [1, 2, 3, 4, 6])
@pytest.mark.parametrize("calls", [6, 12])
def test_a_few_calls_that_are_transported_find_it_too(calls: int, dimensions: int):
    assert solve(dimensions, f"transport:calls={calls}") < 0.003


@pytest.mark.parametrize(("dimensions", "calls"), [(1, 6), (2, 12), (3, 24), (6, 48)])
def test_calls_that_correct_a_cheap_model_find_it_when_there_are_several_for_each_parameter(
    dimensions: int, calls: int
):
    assert solve(dimensions, f"residual:calls={calls}") < 0.02


def test_a_circle_s_seam_costs_nothing():
    problem = Problem(Basins(3), STATE, np.zeros((2, 2), dtype=np.float32))
    space = Space.of(problem)

    def play(turn: float) -> float:
        planner = Planner(space.limits, seed=0, circular=space.circular)
        peak = np.array([0.1, -0.2, turn])
        for _ in range(50):
            index, action = planner.ask()
            planner.tell(index, -float(distance(action[None], peak)[0]))
        assert planner.incumbent is not None
        return float(distance(planner.incumbent.action[None], peak)[0])

    assert max(play(0.5), play(0.0)) < 0.01
