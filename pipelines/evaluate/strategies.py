"""Strategies side by side on the same targets: the raw results."""

import time
from collections.abc import Iterator, Mapping, Set
from pathlib import Path
from typing import Any

from common.domain.case import Case
from common.domain.deviation import DeviationEstimator
from common.domain.errors import RequestError
from common.domain.grid import Grid
from common.planning.optimize import optimize
from common.planning.problem import Problem
from common.planning.selection import parse_strategy
from common.storage.cases import read_case
from common.tasks import TASKS
from common.tasks.plating_sampler import Settler
from pipelines.cases import make_cases, random_recipes
from pipelines.evaluate.strategies_controls import CONTROLS
from pipelines.evaluate.threshold import TRUSTED, Equipment, Method, Plan, record, simulated_reward

SPLITS = {"development": 70_001, "held-out": 90_001}
"""Seed of the targets by split; strategies are tuned on the first alone."""
REFERENCE = f"only:{TRUSTED}"
STRATEGIES = (
    REFERENCE,
    "fast",
    "balanced",
    "quality",
    "residual:calls=3",
    "residual:calls=6",
    "residual:calls=12",
    "threshold",
    "only:heuristic",
)
"""What is compared by default; ``<strategy>+constant-mde`` and ``<strategy>+oracle-mde`` swap the MDEs."""


def make_plan(targets: int, strategies: tuple[str, ...], *, evaluations: int, seed: int = 0) -> Plan:
    """Return the experiment, always with the reference.

    Raises:
        RequestError: There is no such strategy or control.
    """
    for name in strategies:
        strategy, _, control = name.partition("+")
        parse_strategy(strategy)
        if control and control not in CONTROLS:
            raise RequestError(f"control: expected one of {', '.join(CONTROLS)}, got {control!r}")
    names = dict.fromkeys((REFERENCE, *strategies))
    return Plan(targets, seed, evaluations, tuple(Method(name) for name in names))


def find_targets(count: int, split: str, folder: Path, *, settle: Settler, equipment: Equipment) -> list[Case]:
    """Return the targets, every second one made with another item; those that the folder does not hold are made."""
    recipes = random_recipes(count, SPLITS[split])
    make_cases(recipes, folder, settle=settle, model=equipment.models[TRUSTED], grid=Grid())
    return [read_case(folder / f"{recipe.name}.npz") for recipe in recipes]


def run_strategies(
    case: Case, index: int, plan: Plan, equipment: Equipment, done: Set[str], *, in_flight: int = 1
) -> Iterator[dict[str, Any]]:
    """Optimise one target with every method that is not done, and yield a record of each.

    ``process_s`` is the time that this process computed, which other work on the machine does not lengthen.
    """
    problem = Problem(TASKS["plating"], case.state, case.target)
    for method in plan.methods:
        if method.label in done:
            continue
        strategy, _, control = method.strategy.partition("+")
        began = time.process_time()
        result = optimize(
            problem,
            equipment.models,
            _estimators(control, equipment),
            strategy=strategy,
            d_max=method.d_max,
            evaluations=plan.evaluations,
            in_flight=in_flight,
            seed=plan.seed + index,
        )
        process_s = time.process_time() - began
        reward = simulated_reward(problem, result, equipment.models[TRUSTED])
        yield {**record(case, index, method, result, true_reward=reward), "process_s": process_s}


def _estimators(control: str, equipment: Equipment) -> Mapping[str, DeviationEstimator]:
    if not control:
        return equipment.estimators
    swap, simulator = CONTROLS[control], equipment.models[TRUSTED]
    return {
        name: swap(estimator, equipment.models[name], simulator) for name, estimator in equipment.estimators.items()
    }
