"""Strategies side by side on the same targets: the raw results."""

from collections.abc import Iterator, Mapping, Sequence, Set
from contextlib import contextmanager
from dataclasses import asdict, dataclass, is_dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from common.domain.case import Case
from common.domain.deviation import DeviationEstimator
from common.domain.errors import FrugalError, ModelError, RequestError
from common.domain.grid import Grid
from common.domain.model import PredictiveModel
from common.domain.trial import Result
from common.planning.optimize import optimize
from common.planning.problem import Problem
from common.tasks import TASKS
from common.tasks.plating_sampler import Settler
from pipelines.cases import make_cases, random_recipes
from pipelines.evaluate.strategies_controls import Scaling, TrustingEstimator, controlled
from pipelines.evaluate.strategies_meter import Meter, Metered, MeteredEstimator
from pipelines.evaluate.strategies_methods import Contender, make_strategy, parse_contender, reference
from pipelines.evaluate.strategies_pool import Make, PooledModel
from pipelines.evaluate.threshold import TRUSTED, Plan, record

SPLITS = {"development": 70_001, "held-out": 90_001}
"""Seed of the targets by split; strategies are tuned on the first alone."""
JITTER_M = 3e-4
"""Standard deviation of an execution error along each action parameter [m]."""


@dataclass(frozen=True)
class Comparison(Plan):
    """One experiment.

    Attributes:
        methods: What is compared, the reference first.
        trusted: The trusted model.
        jitter: Execution errors that each answer is tried with.
    """

    methods: tuple[Contender, ...] = ()
    trusted: str = TRUSTED
    jitter: int = 4


def make_plan(
    targets: int,
    strategies: Sequence[str],
    *,
    evaluations: int,
    seed: int = 0,
    trusted: str = TRUSTED,
    jitter: int = 4,
    in_flight: int = 1,
) -> Comparison:
    """Return the experiment, always with the reference.

    Raises:
        RequestError: There is no such strategy or option, or an odd number of execution errors.
    """
    if jitter % 2:
        raise RequestError(f"jitter: expected an even number, errors come with their opposites, got {jitter}")
    names = dict.fromkeys((reference(trusted), *strategies))
    methods = tuple(parse_contender(name, trusted=trusted, in_flight=in_flight) for name in names)
    return Comparison(targets, seed, evaluations, methods, trusted, jitter)


def find_targets(count: int, split: str, folder: Path, *, settle: Settler, simulator: PredictiveModel) -> list[Path]:
    """Return the files of the targets, every second one made with another item; those that are not there are made."""
    recipes = random_recipes(count, SPLITS[split])
    make_cases(recipes, folder, settle=settle, model=simulator, grid=Grid())
    return [folder / f"{recipe.name}.npz" for recipe in recipes]


class Kit:
    """What optimises in this process, metered.

    Args:
        models: Models by name, from cheapest to dearest, the trusted one among them.
        estimators: MDEs by the name of their model.
        scalings: What the MDEs' cards say, by the name of their model.
        trusted: Name of the trusted model.
        make_trusted: Makes another trusted model, in a process of its own; it has to be pickled.
    """

    def __init__(
        self,
        models: Mapping[str, PredictiveModel],
        estimators: Mapping[str, DeviationEstimator],
        scalings: Mapping[str, Scaling],
        *,
        trusted: str,
        make_trusted: Make,
    ) -> None:
        self.meter = Meter()
        self.models = {name: Metered(model, self.meter, keeps=name == trusted) for name, model in models.items()}
        self.estimators = {name: MeteredEstimator(mde, self.meter) for name, mde in estimators.items()}
        self.trusted = self.models[trusted]
        self._scalings = scalings
        self._make_trusted = make_trusted
        self._pools: dict[int, PooledModel] = {}

    @property
    def costs(self) -> dict[str, float]:
        """What a call of each model takes on the present target, by name [s]."""
        return {name: model.call.wall_s for name, model in self.models.items()}

    def start_target(self, problem: Problem) -> None:
        """Forget the last target, and measure what preparing this one takes."""
        for part in (*self.models.values(), *self.estimators.values()):
            part.start_target(problem)

    @contextmanager
    def run(self, method: Contender, problem: Problem) -> Iterator["Run"]:
        """Give a method its models and MDEs, and measure it."""
        for part in (*self.models.values(), *self.estimators.values()):
            part.start_run()
        models: dict[str, PredictiveModel] = {**self.models}
        estimators: Mapping[str, DeviationEstimator] = self.estimators
        if method.control:
            estimators = controlled(
                method.control, models, self._scalings, trusted=self.trusted, meter=self.meter
            )  # fmt: skip
        if method.trusting:
            estimators = {name: TrustingEstimator(mde) for name, mde in estimators.items()}
        pool = None
        if method.in_flight > 1:
            pool = self._pool(method.in_flight)
            pool.prepare(problem.state, problem.limits.mean(axis=1)[None])
            alone = Metered(pool, self.meter)
            alone.start_run(self.trusted.preparation)
            models[pool.name] = alone
        pooled_s, began = 0.0 if pool is None else pool.processor_s, self.meter.now()
        run = Run(models, estimators)
        yield run
        run.processor_s = (self.meter.now() - began).processor_s
        if pool is not None:
            run.processor_s += pool.processor_s - pooled_s

    def close(self) -> None:
        """End the processes."""
        for pool in self._pools.values():
            pool.close()

    def _pool(self, count: int) -> PooledModel:
        if count not in self._pools:
            self._pools[count] = PooledModel(self._make_trusted, count=count)
        return self._pools[count]


@dataclass
class Run:
    """One method at work.

    Attributes:
        models: Its models by name.
        estimators: Its MDEs by the name of their model.
        processor_s: Processor time that it paid for [s]; known when it is done.
    """

    models: Mapping[str, PredictiveModel]
    estimators: Mapping[str, DeviationEstimator]
    processor_s: float = 0.0


def run_strategies(
    case: Case, index: int, plan: Comparison, kit: Kit, done: Set[str]
) -> Iterator[dict[str, Any]]:  # fmt: skip
    """Optimise one target with every method that is not done, and yield a record of each.

    Methods take turns at being the first, so that a machine whose speed drifts is as fast for all of them. What an
    answer is worth is simulated where the method did not do so, and under execution errors that are the same for all
    methods; nobody pays for either. A method that fails is recorded with its error.
    """
    problem = Problem(TASKS["plating"], case.state, case.target)
    kit.start_target(problem)
    errors = _execution_errors(plan, index, parameters=len(problem.limits))
    first = index % len(plan.methods)
    for method in (*plan.methods[first:], *plan.methods[:first]):
        if method.label in done:
            continue
        try:
            yield _run(case, index, method, plan, kit, problem, errors)
        except FrugalError as error:
            yield {"target": index, "case": case.name, "method": method.label, "error": f"{error.code}: {error}"}


def _run(
    case: Case,
    index: int,
    method: Contender,
    plan: Comparison,
    kit: Kit,
    problem: Problem,
    errors: NDArray[np.float64],
) -> dict[str, Any]:
    strategy = make_strategy(method.strategy, trusted=plan.trusted, costs=kit.costs)
    with kit.run(method, problem) as run:
        result = optimize(
            problem,
            run.models,
            run.estimators,
            strategy=strategy,
            d_max=method.d_max,
            evaluations=plan.evaluations,
            in_flight=method.in_flight,
            seed=plan.seed + index,
            trusted=plan.trusted,
            clock=kit.meter.clock,
        )
    true_reward = _simulated(kit, problem, result.action)
    return {
        **record(case, index, method, result, true_reward=true_reward),
        "process_s": run.processor_s,
        "calls": result.usage.get(plan.trusted, 0),
        "budget": strategy.budget(plan.evaluations),
        "d_max": method.d_max,
        "jitter_reward": _mean([_simulated(kit, problem, action) for action in result.action + errors]),
        "certificate": _certificate(result),
    }


def _execution_errors(plan: Comparison, index: int, *, parameters: int) -> NDArray[np.float64]:
    """Return errors ``(J, n)`` [m], each with its opposite."""
    half = np.random.default_rng([plan.seed, index]).normal(0, JITTER_M, (plan.jitter // 2, parameters))
    return np.concatenate([half, -half])


def _simulated(kit: Kit, problem: Problem, action: Sequence[float] | NDArray[np.float64]) -> float | None:
    """Return the reward of an action as the trusted model sees it [m]; None if it cannot say."""
    try:
        with kit.meter.unpaid():
            heights = kit.trusted.predict(problem.state, np.array([action])).heights[0]
    except ModelError:
        return None
    return float(problem.task.reward(heights, problem.target))


def _mean(values: Sequence[float | None]) -> float | None:
    known = [value for value in values if value is not None]
    return float(np.mean(known)) if known else None


def _certificate(result: Result) -> dict[str, Any] | None:
    """Return what the result says about what it may have missed; None if it says nothing."""
    found = getattr(result, "certificate", None)
    return asdict(found) if is_dataclass(found) and not isinstance(found, type) else None
