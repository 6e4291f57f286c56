"""Measure what a step of the optimiser costs at 50 points, beside the same loop with scikit-learn's regressor.

Run ``python benchmarks/optimizer.py [--json]`` from the root of the checkout; it takes about half a minute.
"""

import argparse
import json
import time
import warnings
from collections.abc import Callable
from statistics import median

import numpy as np
from numpy.typing import NDArray
from sklearn.exceptions import ConvergenceWarning
from sklearn.gaussian_process import GaussianProcessRegressor
from sklearn.gaussian_process.kernels import ConstantKernel, Matern, WhiteKernel
from threadpoolctl import threadpool_limits

from common.domain.grid import Grid
from common.domain.model import PredictiveModel
from common.domain.scene import Item, Scene, State
from common.planning.optimize import optimize
from common.planning.planner import INITIAL, Planner
from common.planning.problem import Problem
from common.planning.ucb import spread
from common.tasks.plating import Plating
from services.heuristic import HeuristicModel

BOUNDS = np.array([[-0.08, 0.08], [-0.08, 0.08]])
PEAK = np.array([0.031, -0.022])
AT = range(46, 55)
SEEDS = range(5)


class ReferencePlanner:
    """The same loop with scikit-learn's regressor, its length scale fitted in every step, on the same grid."""

    def __init__(self, *, seed: int) -> None:
        self._start = Planner(BOUNDS, seed=seed)
        self._grid = BOUNDS[:, 0] + spread(2) * np.ptp(BOUNDS, axis=1)
        self._actions: list[NDArray[np.float64]] = []
        self._rewards: list[float] = []

    def ask(self) -> tuple[int, NDArray[np.float64]]:
        """Return the index of a new trial and its action ``(2,)`` [m]."""
        index = len(self._actions)
        if index < INITIAL:
            action = self._start.ask()[1]
        else:
            kernel = ConstantKernel() * Matern(0.03, (0.005, 0.2), nu=2.5) + WhiteKernel(1e-4, (1e-6, 1e-2))
            process = GaussianProcessRegressor(kernel, normalize_y=True)
            with warnings.catch_warnings():
                warnings.simplefilter("ignore", ConvergenceWarning)
                process.fit(np.array(self._actions), self._rewards)
            mean, deviation = process.predict(self._grid, return_std=True)
            action = self._grid[int((mean + 2 * deviation).argmax())]
        self._actions.append(action)
        return index, action

    def tell(self, index: int, reward: float) -> None:
        """Learn what the last trial was worth."""
        self._rewards.append(reward)


def step_ms(planner_for: Callable[[int], Planner | ReferencePlanner]) -> float:
    """Return the median time of asking and telling around 50 points [ms]."""
    steps: list[float] = []
    for seed in SEEDS:
        planner = planner_for(seed)
        for count in range(AT.stop):
            began = time.perf_counter()
            index, action = planner.ask()
            asked = time.perf_counter()
            reward = -float(np.linalg.norm(action - PEAK))
            told = time.perf_counter()
            planner.tell(index, reward)
            if count in AT:
                steps.append(asked - began + time.perf_counter() - told)
    return 1e3 * median(steps)


def loop_ms() -> float:
    """Return the median time of one evaluation in `optimize` around 50 points that is not the model's [ms]."""
    grid = Grid()
    inside = np.hypot(grid.x[None, :] / 0.03, grid.y[:, None] / 0.04) < 1
    materials = np.array([1000.0, 3e4, 0.4])[:, None, None] * inside
    item = Item((0.015 * inside).astype(np.float32), materials.astype(np.float32))
    state = State(Scene(grid, np.zeros(grid.shape, np.float32), np.zeros((3, *grid.shape), np.float32)), item)
    model: PredictiveModel = HeuristicModel()
    target = model.predict(state, PEAK[None]).heights[0]
    steps: list[float] = []
    for seed in SEEDS:
        trials = optimize(
            Problem(Plating(), state, target),
            {model.name: model},
            {},
            strategy=f"only:{model.name}",
            evaluations=AT.stop + 1,
            seed=seed,
        ).trials
        starts = [trial.started_s for trial in trials]
        steps += [starts[count + 1] - starts[count] - trials[count].compute_s for count in AT]
    return 1e3 * median(steps)


def main() -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--json", action="store_true", help="print one JSON object")
    as_json = parser.parse_args().json
    with threadpool_limits(1):  # on small matrices more threads cost time, on a busy machine a lot
        own = step_ms(lambda seed: Planner(BOUNDS, seed=seed))
        reference = step_ms(lambda seed: ReferencePlanner(seed=seed))
        loop = loop_ms()
    if as_json:
        print(json.dumps({"overhead_ms_at_50": loop, "planner_ms_at_50": own, "sklearn_ms_at_50": reference}))
    else:
        print(f"planner, ask and tell at 50 points:        {own:6.1f} ms")
        print(f"scikit-learn in the same loop:             {reference:6.1f} ms, {reference / own:.1f} times as long")
        print(f"optimize, all but the model, at 50 points: {loop:6.1f} ms")


if __name__ == "__main__":
    main()
