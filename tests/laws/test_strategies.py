"""Laws that every strategy obeys, whatever it asks and whoever fails."""

import threading
from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np
import pytest
from numpy.typing import NDArray

from common.domain.deviation import DeviationEstimator, Estimates
from common.domain.errors import CancelledError, ModelError, UnavailableError
from common.domain.grid import Floats, Grid
from common.domain.heightmap import shift
from common.domain.model import PredictiveModel
from common.domain.scene import Item, Scene, State
from common.domain.trial import Result
from common.planning.optimize import optimize
from common.planning.problem import Problem
from common.planning.selection import STRATEGIES
from common.tasks.plating import Plating
from services.heuristic import HeuristicModel

GRID = Grid(32, 32, 0.006)
ALL = [*STRATEGIES, "transport:calls=5", "residual:calls=5", "only:simulator"]
OURS = [name for name in ALL if name.partition(":")[0] not in ("threshold", "random", "only")]
TRUE_ACTION = np.array([0.0213, -0.0131])
BUDGETS = {"fast": 2, "balanced": 4, "transport:calls=5": 5, "residual:calls=5": 5}


def a_state() -> State:
    x, y = GRID.x[None, :], GRID.y[:, None]
    scene = np.where(np.hypot(x, y) < 0.06, 0.0, 0.01) + 0.01 * np.exp(-((x - 0.02) ** 2 + y**2) / 2e-4)
    item = 0.015 * np.exp(-((x / 0.02) ** 2 + (y / 0.03) ** 2))
    item[item < 0.003] = 0
    materials = np.where(item > 0, np.array([1000.0, 3e4, 0.4])[:, None, None], 0)
    return State(Scene(GRID, scene, np.zeros((3, *GRID.shape))), Item(item, materials))


@dataclass
class Draping(PredictiveModel):
    """A trusted model: the item sinks into what is below it; ``trouble`` is called with the number of each call."""

    name: str = "simulator"
    version: str = "1"
    trouble: Callable[[int], object] = lambda call: None
    calls: int = 0
    lock: threading.Lock = field(default_factory=threading.Lock)

    def outcomes(self, state: State, actions: NDArray[np.float64]) -> tuple[Floats, tuple[str, ...]]:
        with self.lock:
            call, self.calls = self.calls, self.calls + 1
        self.trouble(call)
        below = state.scene.heights
        moved = np.stack([shift(state.item.heights, *(action / state.grid.cell)) for action in actions])
        return np.where(moved > 0, 0.6 * below + moved, below), ("",) * len(actions)


class Even(DeviationEstimator):
    """The same estimate everywhere, or a failure."""

    model = "heuristic"
    version = "1"

    def __init__(self, error: Exception | None = None) -> None:
        self.error = error

    def deviations(self, state: State, actions: NDArray[np.float64]) -> Estimates:
        if self.error is not None:
            raise self.error
        mean = np.where(actions[:, 0] > 0, 0.3, 0.6)
        return Estimates(mean, mean, np.ones(len(actions), dtype=bool))


class Broken(PredictiveModel):
    """A cheap model that always fails."""

    name = "heuristic"
    version = "1"

    def outcomes(self, state: State, actions: NDArray[np.float64]) -> tuple[Floats, tuple[str, ...]]:
        raise ModelError("broken")


STATE = a_state()
PROBLEM = Problem(Plating(), STATE, Draping().outcomes(STATE, TRUE_ACTION[None])[0][0])


def run(strategy: str, models=None, estimators=None, **options) -> Result:
    models = [HeuristicModel(), Draping()] if models is None else models
    estimators = [Even()] if estimators is None else estimators
    return optimize(
        PROBLEM,
        {model.name: model for model in models},
        {estimator.model: estimator for estimator in estimators},
        **{"strategy": strategy, "evaluations": 14, **options},
    )


def fail_in(*calls: int) -> Callable[[int], object]:
    def trouble(call: int) -> None:
        if call in calls:
            raise ModelError("it slipped")

    return trouble


def evidence(result: Result):
    return [(trial.index, trial.action, trial.model, trial.reward, trial.error) for trial in result.trials]


@pytest.mark.parametrize("strategy", ALL)
@pytest.mark.parametrize("in_flight", [1, 3])
def test_the_same_seed_gives_the_same_trials(strategy: str, in_flight: int):
    first, second = (run(strategy, in_flight=in_flight, seed=5) for _ in range(2))
    assert evidence(first) == evidence(second)
    assert first.usage == second.usage


@pytest.mark.parametrize("strategy", ALL)
@pytest.mark.parametrize("evaluations", [1, 4, 14])
def test_no_more_actions_are_evaluated_than_allowed_and_none_twice(strategy: str, evaluations: int):
    simulator = Draping()
    result = run(strategy, [HeuristicModel(), simulator], evaluations=evaluations)
    assert len(result.trials) <= min(evaluations, BUDGETS.get(strategy, 50))
    assert simulator.calls == result.usage.get("simulator", 0) <= len(result.trials)
    assert len({trial.action for trial in result.trials}) == len(result.trials)
    low, high = PROBLEM.limits.T
    assert all((low <= trial.action).all() and (trial.action <= high).all() for trial in result.trials)


@pytest.mark.parametrize("strategy", ALL)
def test_the_answer_is_the_best_trial(strategy: str):
    result = run(strategy)
    best = max(result.trials, key=lambda trial: trial.reward or -1)
    assert (result.action, result.reward) == (best.action, best.reward)
    assert float(PROBLEM.task.reward(result.heights, PROBLEM.target)) == pytest.approx(result.reward)


@pytest.mark.parametrize("strategy", OURS)
@pytest.mark.parametrize("in_flight", [1, 2])
def test_ours_answer_with_a_simulated_action_near_the_true_one(strategy: str, in_flight: int):
    result = run(strategy, in_flight=in_flight)
    assert {trial.model for trial in result.trials} == {"simulator"}
    assert np.linalg.norm(result.action - TRUE_ACTION) < 2.5e-3
    assert result.usage["heuristic"] > 100


@pytest.mark.parametrize("strategy", ALL)
@pytest.mark.parametrize("in_flight", [1, 3])
def test_a_simulator_that_fails_now_and_then_costs_a_trial_and_not_the_answer(strategy: str, in_flight: int):
    result = run(strategy, [HeuristicModel(), Draping(trouble=fail_in(0, 2))], in_flight=in_flight)
    assert result.reward <= 0
    for trial in result.trials:
        assert (trial.reward is None) == ("it slipped" in trial.error)


@pytest.mark.parametrize("strategy", ALL)
def test_a_cheap_model_or_an_mde_that_fails_does_not_end_the_run(strategy: str):
    for models, estimators in (
        ([Broken(), Draping()], [Even()]),
        ([HeuristicModel(), Draping()], [Even(ModelError("blind"))]),
        ([HeuristicModel(), Draping()], []),
    ):
        result = run(strategy, models, estimators)
        assert result.trials[-1].model in ("heuristic", "simulator")


@pytest.mark.parametrize("strategy", OURS)
def test_ours_need_no_cheap_model(strategy: str):
    result = run(strategy, [Draping()], [])
    assert result.usage == {"simulator": len(result.trials)}


@pytest.mark.parametrize("strategy", ALL)
def test_a_broken_simulator_is_given_up_after_three_calls_or_what_the_budget_allows(strategy: str):
    simulator = Draping(trouble=fail_in(*range(50)))
    with pytest.raises(ModelError, match="it slipped"):
        run(strategy, [simulator], [])
    assert simulator.calls == min(3, BUDGETS.get(strategy, 3))


@pytest.mark.parametrize("strategy", OURS)
def test_at_the_deadline_a_cheap_model_s_word_is_the_answer_if_there_is_no_other(strategy: str):
    release, begun = threading.Event(), threading.Event()

    def hang(call: int) -> None:
        begun.set()
        release.wait(10)

    try:
        result = run(
            strategy,
            [HeuristicModel(), Draping(trouble=hang)],
            deadline_s=1.0,
            clock=lambda: 1.0 if begun.is_set() else 0.0,
        )
    finally:
        release.set()
    assert result.trials[-1].model == "heuristic"
    assert result.action == result.trials[-1].action
    assert np.linalg.norm(np.array(result.action) - TRUE_ACTION) < 0.02
    assert ["deadline" in trial.error for trial in result.trials] == [True, False]


@pytest.mark.parametrize("strategy", OURS)
def test_a_sweep_that_hangs_ends_at_the_deadline_and_with_a_cancellation(strategy: str):
    release, begun = threading.Event(), threading.Event()

    class Hanging(HeuristicModel):
        def outcomes(self, state: State, actions: NDArray[np.float64]) -> tuple[Floats, tuple[str, ...]]:
            begun.set()
            release.wait(10)
            return super().outcomes(state, actions)

    try:
        with pytest.raises(Exception, match="deadline_s"):
            run(strategy, [Hanging(), Draping()], deadline_s=0.05)
        with pytest.raises(CancelledError):
            run(strategy, [Hanging(), Draping()], cancelled=begun.is_set)
    finally:
        release.set()


@pytest.mark.parametrize("strategy", OURS)
def test_the_trusted_model_is_required(strategy: str):
    with pytest.raises(UnavailableError, match="expected the model simulator, got heuristic"):
        run(strategy, [HeuristicModel()], [])


def test_simulations_in_flight_are_spread():
    barrier = threading.Barrier(2, timeout=10)
    result = run("transport:calls=4", [HeuristicModel(), Draping(trouble=lambda call: barrier.wait())], in_flight=2)
    first, second = (np.array(trial.action) for trial in result.trials[:2])
    assert np.linalg.norm(first - second) > 5e-4
