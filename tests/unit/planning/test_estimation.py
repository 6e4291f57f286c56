"""Estimates for the actions that are asked together."""

import threading
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field

import numpy as np
import pytest
from numpy.typing import NDArray
from planning_fakes import FakeEstimator, FakeModel, small_problem

from common.domain.deviation import Estimates
from common.domain.errors import ModelError, RequestError
from common.domain.scene import State
from common.planning.estimation import Round
from common.planning.optimize import optimize

PROBLEM = small_problem()
ACTIONS = np.array([[0.01, 0.0], [-0.02, 0.01], [0.03, -0.01]])


@dataclass
class Recording(FakeEstimator):
    """Remembers the actions of every batch; the estimate grows with x."""

    batches: list[NDArray[np.float64]] = field(default_factory=list)

    def deviations(self, state: State, actions: NDArray[np.float64]) -> Estimates:
        self.batches.append(actions)
        return super().deviations(state, actions)


def a_round(estimator: FakeEstimator) -> Round:
    return Round(PROBLEM.state, ACTIONS, {estimator.model: estimator}, now=lambda: 0.0)


def test_an_mde_is_asked_once_for_the_whole_round_and_each_action_gets_its_own_estimate():
    estimator = Recording(mean=lambda x: 0.5 + x)
    together = a_round(estimator)
    means = [told.estimate.mean for told in (together.consult("heuristic", n) for n in range(3)) if told.estimate]
    assert means == pytest.approx([0.51, 0.48, 0.53])
    assert len(estimator.batches) == 1
    np.testing.assert_array_equal(estimator.batches[0], ACTIONS)


def test_threads_that_ask_at_once_cause_one_request():
    release, estimator = threading.Event(), Recording(mean=lambda x: release.wait(5) * (0.5 + x))
    together = a_round(estimator)
    with ThreadPoolExecutor(3) as pool:
        asked = [pool.submit(together.consult, "heuristic", position) for position in range(3)]
        release.set()
        means = [told.estimate.mean for told in (future.result() for future in asked) if told.estimate]
    assert means == pytest.approx([0.51, 0.48, 0.53])
    assert len(estimator.batches) == 1


def test_a_round_larger_than_the_largest_batch_is_asked_in_parts():
    estimator = Recording(mean=lambda x: 0.5 + x)
    estimator.largest_batch = 2
    told = a_round(estimator).consult("heuristic", 2)
    assert told.estimate is not None
    assert told.estimate.mean == pytest.approx(0.53)
    assert [len(batch) for batch in estimator.batches] == [2, 1]


def test_an_mde_that_fails_has_failed_for_the_round_and_is_one_event():
    estimator = FakeEstimator(error=ModelError("no weights"))
    together = a_round(estimator)
    told = [together.consult("heuristic", position) for position in range(3)]
    assert [one.estimate for one in told] == [None] * 3
    assert [(event.kind, event.worker) for one in told for event in one.events] == [("model_error", "mde/heuristic")]
    assert estimator.calls == 1


def test_a_refusal_reaches_every_evaluation_of_the_round():
    together = a_round(FakeEstimator(error=RequestError("no such plate")))
    for position in range(3):
        with pytest.raises(RequestError, match="no such plate"):
            together.consult("heuristic", position)


def test_actions_asked_together_are_estimated_together_and_go_to_different_models():
    estimator = Recording(mean=lambda x: 0.2 if x < 0 else 0.6)
    models = {"heuristic": FakeModel(name="heuristic"), "simulator": FakeModel()}
    result = optimize(PROBLEM, models, {"heuristic": estimator}, strategy="threshold", evaluations=8, in_flight=8)
    assert [len(batch) for batch in estimator.batches] == [8]
    assert set(result.usage) == {"heuristic", "simulator"}
    assert all(trial.model == ("heuristic" if trial.action[0] < 0 else "simulator") for trial in result.trials)


def test_one_evaluation_at_a_time_means_one_action_a_batch():
    estimator = Recording()
    models = {"heuristic": FakeModel(name="heuristic"), "simulator": FakeModel()}
    optimize(PROBLEM, models, {"heuristic": estimator}, strategy="threshold", evaluations=9)
    assert [len(batch) for batch in estimator.batches] == [1] * 9


@pytest.mark.parametrize("in_flight", [1, 4])
def test_unfamiliar_inputs_go_to_the_trusted_model_and_are_seen_in_the_result(in_flight: int):
    models = {"heuristic": FakeModel(name="heuristic"), "simulator": FakeModel()}
    estimators = {"heuristic": FakeEstimator(familiar=False)}
    result = optimize(PROBLEM, models, estimators, strategy="threshold", evaluations=8, in_flight=in_flight)
    assert result.usage == {"simulator": 8}
    assert all(trial.unfamiliar == ("heuristic",) for trial in result.trials)
    assert [(event.kind, event.worker) for event in result.events] == [("unfamiliar", "mde/heuristic")]


def test_trials_keep_mean_and_upper_bound():
    models = {"heuristic": FakeModel(name="heuristic"), "simulator": FakeModel()}
    result = optimize(PROBLEM, models, {"heuristic": FakeEstimator(margin=0.25)}, strategy="threshold", evaluations=3)
    assert all(trial.estimates == {"heuristic": 0.1} for trial in result.trials)
    assert all(trial.uppers == {"heuristic": pytest.approx(0.35)} for trial in result.trials)
    assert all(trial.unfamiliar == () for trial in result.trials)


@pytest.mark.parametrize("strategy", ["threshold", "quality", "residual", "only:simulator"])
def test_an_mde_of_the_trusted_model_tells_in_its_trials_and_changes_nothing_else(strategy: str):
    models = {"heuristic": FakeModel(name="heuristic"), "simulator": FakeModel()}
    estimators = {"heuristic": FakeEstimator(mean=lambda x: 0.2 if x < 0 else 0.6)}
    trusted = FakeEstimator(model="simulator", mean=lambda x: 0.9, margin=0.05, familiar=False)
    options = {"strategy": strategy, "evaluations": 8}
    without = optimize(PROBLEM, models, estimators, **options)
    found = optimize(PROBLEM, models, {**estimators, "simulator": trusted}, **options)
    assert [(trial.action, trial.model) for trial in found.trials] == [
        (trial.action, trial.model) for trial in without.trials
    ]
    assert found.usage == without.usage
    told = [trial for trial in found.trials if trial.model == "simulator"]
    assert told
    assert all(trial.estimates["simulator"] == 0.9 for trial in told)
    assert all(trial.uppers["simulator"] == pytest.approx(0.95) for trial in told)
    assert all("simulator" in trial.unfamiliar for trial in told)


def test_a_failing_mde_of_the_trusted_model_is_an_event():
    estimators = {"simulator": FakeEstimator(model="simulator", error=ModelError("no weights"))}
    result = optimize(PROBLEM, {"simulator": FakeModel()}, estimators, strategy="only:simulator", evaluations=1)
    assert result.usage == {"simulator": 1}
    assert [(event.kind, event.worker) for event in result.events] == [("model_error", "mde/simulator")]


def test_the_threshold_on_the_upper_bound_is_stricter():
    models = {"heuristic": FakeModel(name="heuristic"), "simulator": FakeModel()}
    estimators = {"heuristic": FakeEstimator(mean=lambda x: 0.3, margin=0.2)}
    for strategy, expected in (("threshold", "heuristic"), ("threshold:upper", "simulator")):
        result = optimize(PROBLEM, models, estimators, evaluations=4, strategy=strategy)
        assert result.usage == {expected: 4}
