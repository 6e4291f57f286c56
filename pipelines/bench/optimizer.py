"""What a step of the optimiser costs at 50 points, beside the same loop with scikit-learn's and BoTorch's models."""

import time
from collections.abc import Callable
from functools import partial
from statistics import median
from typing import Any

import numpy as np

from common.domain.grid import Grid
from common.domain.scene import Item, Scene, State
from common.planning.optimize import optimize
from common.planning.plan_ucb import MakePlanner
from common.planning.planner import Planner
from common.planning.planner_sklearn import SklearnPlanner
from common.planning.problem import Problem
from common.tasks.plating import Plating
from pipelines.optimizers.botorch_planner import BotorchPlanner
from services.heuristic import HeuristicModel

BOUNDS = np.array([[-0.08, 0.08], [-0.08, 0.08]])
PEAK = np.array([0.031, -0.022])
AT = range(46, 55)
"""Steps that are timed: those around 50 points."""

Report = Callable[[int, int], None]
Times = tuple[float, float]

PLANNERS: dict[str, MakePlanner] = {
    "planner": partial(Planner, initial=AT.start),
    "sklearn": partial(SklearnPlanner, initial=AT.start),
    "botorch": partial(BotorchPlanner, initial=AT.start, acquisition="logei"),
    "botorch_ucb": partial(BotorchPlanner, initial=AT.start, acquisition="ucb"),
}
"""What asks and tells: ours, and the same loop with other models, all of them after the same spread actions."""


def bench_optimizer(*, seeds: int, report: Report = lambda done, total: None) -> dict[str, Any]:
    """Return medians around 50 points [ms], and how many times as long the other loops take as ours.

    ``overhead`` is all of a step of `optimize` that is not the model's: asking, evaluating, telling. The others are
    asking and telling alone: ours, scikit-learn's, BoTorch's with its default acquisition function, expected
    improvement, and with the upper confidence bound. Wall time is ``<name>_ms_at_50``; processor time,
    ``<name>_processor_ms_at_50``, is what it would be on an idle machine. Planners take turns step by step, so that
    other work on the machine lengthens all of them alike.
    """
    steps: dict[str, list[Times]] = {name: [] for name in ("overhead", *PLANNERS)}
    for seed in range(seeds):
        planners = {name: make(BOUNDS, seed=seed) for name, make in PLANNERS.items()}
        for count in range(AT.stop):
            for name, planner in planners.items():
                took = _step(planner)
                if count in AT:
                    steps[name].append(took)
            report(seed * AT.stop + count + 1, seeds * AT.stop)
        steps["overhead"] += zip(
            overhead_steps(seed, clock=time.perf_counter), overhead_steps(seed, clock=time.process_time), strict=True
        )
    found: dict[str, float] = {}
    for name, times in steps.items():
        wall, processor = (1e3 * median(column) for column in zip(*times, strict=True))
        found |= {f"{name}_ms_at_50": wall, f"{name}_processor_ms_at_50": processor}
    return {
        **found,
        "sklearn_ratio": found["sklearn_processor_ms_at_50"] / found["overhead_processor_ms_at_50"],
        "botorch_ratio": found["botorch_processor_ms_at_50"] / found["overhead_processor_ms_at_50"],
        "seeds": seeds,
    }


def _step(planner: Planner) -> Times:
    """Return the time of asking for an action and telling its reward, by the wall's and the processor's clock [s]."""
    began = time.perf_counter(), time.process_time()
    index, action = planner.ask()
    planner.tell(index, -float(np.linalg.norm(action - PEAK)))
    return time.perf_counter() - began[0], time.process_time() - began[1]


def overhead_steps(seed: int, *, clock: Callable[[], float]) -> list[float]:
    """Return the time of evaluations in `optimize` around 50 points that is not the model's [s]."""
    grid, model = Grid(), HeuristicModel()
    inside = np.hypot(grid.x[None, :] / 0.03, grid.y[:, None] / 0.04) < 1
    materials = np.array([1000.0, 3e4, 0.4])[:, None, None] * inside
    item = Item((0.015 * inside).astype(np.float32), materials.astype(np.float32))
    state = State(Scene(grid, np.zeros(grid.shape, np.float32), np.zeros((3, *grid.shape), np.float32)), item)
    target = model.predict(state, PEAK[None]).heights[0]
    trials = optimize(
        Problem(Plating(), state, target),
        {model.name: model},
        {},
        strategy=f"only:{model.name}",
        evaluations=AT.stop + 1,
        seed=seed,
        clock=clock,
    ).trials
    starts = [trial.started_s for trial in trials]
    return [starts[count + 1] - starts[count] - trials[count].compute_s for count in AT]
