"""The loop."""

import itertools
import threading
from dataclasses import replace

import numpy as np
import pytest
from planning_fakes import TRUE_ACTION, FakeEstimator, FakeModel, small_problem

from common.domain.errors import (
    BusyError,
    CancelledError,
    ModelError,
    RequestError,
    TimedOutError,
    UnavailableError,
)
from common.domain.model import Event
from common.domain.trial import Result, Trial
from common.planning.optimize import optimize
from services.heuristic import HeuristicModel

PROBLEM = small_problem()


def run(models=None, estimators=None, **options) -> Result:
    models = [FakeModel()] if models is None else models
    estimators = [] if estimators is None else estimators
    return optimize(
        PROBLEM,
        {model.name: model for model in models},
        {estimator.model: estimator for estimator in estimators},
        **{"strategy": "threshold", "evaluations": 10, **options},
    )


def evidence(result: Result):
    """Return what must not depend on timing."""
    return [
        (trial.index, trial.action, trial.model, trial.version, trial.reward, trial.estimates)
        for trial in result.trials
    ]


@pytest.mark.parametrize("in_flight", [1, 4])
def test_fifty_evaluations_find_the_true_action(in_flight: int):
    result = run([HeuristicModel()], strategy="only:heuristic", evaluations=50, in_flight=in_flight)
    assert np.linalg.norm(np.array(result.action) - TRUE_ACTION) < 5e-4
    assert result.usage == {"heuristic": 50}
    assert result.models == {"heuristic": "1"}
    assert result.strategy == "only:heuristic"


def test_the_result_is_the_best_trial_with_its_heightmap():
    result = run(evaluations=12, in_flight=3)
    best = max(result.trials, key=lambda trial: trial.reward or -1)
    assert (result.action, result.reward) == (best.action, best.reward)
    expected = FakeModel().predict(PROBLEM.state, np.array([best.action])).heights[0]
    np.testing.assert_array_equal(result.heights, expected)
    assert result.reward == pytest.approx(float(PROBLEM.task.reward(result.heights, PROBLEM.target)))


@pytest.mark.parametrize("in_flight", [1, 4])
def test_the_same_seed_gives_identical_trials_whatever_the_order_of_the_answers(in_flight: int):
    gates = [threading.Event() for _ in range(12)]

    def backwards(call: int) -> None:
        # In every group of calls that run together the later ones answer first.
        if in_flight > 1 and call + 1 < 12 and call % in_flight != in_flight - 1:
            gates[call + 1].wait(5)
        gates[call].set()

    shuffled = run([FakeModel(wait=backwards)], evaluations=12, in_flight=in_flight, seed=3)
    plain = run(evaluations=12, in_flight=in_flight, seed=3)
    assert evidence(shuffled) == evidence(plain)
    assert evidence(plain) != evidence(run(evaluations=12, in_flight=in_flight, seed=4))


def test_as_many_evaluations_run_at_once_as_may_be_in_flight():
    barrier = threading.Barrier(4, timeout=5)
    assert len(run([FakeModel(wait=lambda call: barrier.wait())], evaluations=8, in_flight=4).trials) == 8


def test_each_query_goes_to_the_cheapest_applicable_model():
    result = run(
        [FakeModel(name="heuristic"), FakeModel(name="learned"), FakeModel()],
        [FakeEstimator(mean=lambda x: 0.2 if x < 0 else 0.6), FakeEstimator(model="learned", mean=lambda x: 20 * x)],
        evaluations=30,
    )
    for trial in result.trials:
        x = trial.action[0]
        assert trial.model == ("heuristic" if x < 0 else "learned" if x < 0.02 else "simulator")
        assert set(trial.estimates) == ({"heuristic"} if x < 0 else {"heuristic", "learned"})
    assert sum(result.usage.values()) == 30
    assert set(result.usage) == {"heuristic", "learned", "simulator"}
    assert set(result.models) == {*result.usage, "mde/heuristic", "mde/learned"}


def test_a_model_without_an_mde_is_left_alone():
    assert run([FakeModel(name="heuristic"), FakeModel()]).usage == {"simulator": 10}


def test_trials_are_reported_in_the_order_of_asking():
    reported: list[Trial] = []
    result = run(evaluations=9, in_flight=3, on_trial=reported.append)
    assert tuple(reported) == result.trials
    assert [trial.index for trial in reported] == list(range(9))


@pytest.mark.parametrize("error", [ModelError("bad"), UnavailableError("gone"), TimedOutError("slow")])
def test_a_failing_cheap_model_is_replaced_by_the_next_and_recorded(error: Exception):
    result = run(
        [FakeModel(name="heuristic", error=error), FakeModel(name="learned"), FakeModel()],
        [FakeEstimator(), FakeEstimator(model="learned")],
    )
    assert result.usage == {"learned": 10}
    assert [(event.worker, event.detail) for event in result.events] == [("heuristic", str(error))] * 10


def test_the_trusted_model_steps_in_when_all_others_fail():
    result = run(
        [FakeModel(name="heuristic", error=ModelError("bad"), fails=lambda call: call % 2 == 0), FakeModel()],
        [FakeEstimator()],
    )
    assert result.usage == {"heuristic": 5, "simulator": 5}


def test_a_failing_mde_makes_its_model_inapplicable_and_is_recorded():
    result = run([FakeModel(name="heuristic"), FakeModel()], [FakeEstimator(error=UnavailableError("gone"))])
    assert result.usage == {"simulator": 10}
    assert {(event.kind, event.worker) for event in result.events} == {("unavailable", "mde/heuristic")}


@pytest.mark.parametrize("error", [ModelError("bad"), TimedOutError("slow"), BusyError("full")])
@pytest.mark.parametrize("in_flight", [1, 3])
def test_a_failure_of_the_trusted_model_is_one_trial_without_reward(error: Exception, in_flight: int):
    model = FakeModel(error=error, fails=lambda call: call == 4)
    result = run([model], evaluations=10, in_flight=in_flight)
    assert model.calls == len(result.trials) == 10
    (failed,) = [trial for trial in result.trials if trial.reward is None]
    assert str(error) in failed.error
    assert result.usage == {"simulator": 10}
    assert len(result.events) == 1


@pytest.mark.parametrize("error", [RequestError("refused"), CancelledError("gone"), UnavailableError("nobody")])
def test_errors_that_every_further_call_would_meet_end_the_optimisation(error: Exception):
    model = FakeModel(error=error, fails=lambda call: call == 5)
    with pytest.raises(type(error), match=str(error)):
        run([model], evaluations=30)
    assert model.calls == 6


@pytest.mark.parametrize(("evaluations", "calls"), [(20, 3), (2, 2)])
def test_an_optimisation_that_begins_with_failures_only_is_given_up(evaluations: int, calls: int):
    model = FakeModel(error=ModelError("broken"))
    with pytest.raises(ModelError, match="broken"):
        run([model], evaluations=evaluations)
    assert model.calls == calls


def test_a_missing_trusted_model_is_named():
    with pytest.raises(UnavailableError, match="expected the model simulator, got heuristic"):
        run([FakeModel(name="heuristic")], [FakeEstimator()])
    with pytest.raises(UnavailableError, match="expected the model learned, got simulator"):
        run(strategy="only:learned")


def test_another_model_may_be_trusted():
    result = run([FakeModel(name="heuristic"), FakeModel()], trusted="heuristic")
    assert result.usage == {"heuristic": 10}


def test_warnings_stay_with_their_trials():
    result = run([FakeModel(warning="not_settled: 4 mm/s")])
    assert {trial.warning for trial in result.trials} == {"not_settled: 4 mm/s"}


def test_events_of_answers_are_gathered_with_the_time_since_the_start():
    ticks = itertools.count()
    event = Event("no_reply", "simulator/a", "nothing came within 2 s", 1e9)
    result = run([FakeModel(events=(event,))], evaluations=3, clock=lambda: 100.0 + next(ticks))
    assert [replace(gathered, time=1e9) for gathered in result.events] == [event] * 3
    assert all(0 < gathered.time < next(ticks) for gathered in result.events)


def test_time_is_split_between_models_estimates_optimiser_and_transport():
    ticks = itertools.count()
    result = run(
        [FakeModel(name="heuristic", compute_s=0.25), FakeModel()],
        [FakeEstimator()],
        evaluations=4,
        clock=lambda: float(next(ticks)),
    )
    # Each pair of clock readings is one tick apart.
    assert result.split_s["heuristic"] == pytest.approx(4 * 0.25)
    assert result.split_s["mde"] == pytest.approx(4)
    assert result.split_s["transport"] >= 4 * 0.75
    assert result.split_s["optimiser"] >= 3 * 4
    assert set(result.split_s) == {"heuristic", "mde", "optimiser", "transport"}
    assert all(trial.compute_s == 0.25 for trial in result.trials)


def test_a_cancelled_optimisation_ends_at_once_although_a_model_hangs():
    begun, release = threading.Event(), threading.Event()

    def hang(call: int) -> None:
        begun.set()
        release.wait(10)

    try:
        with pytest.raises(CancelledError):
            run([FakeModel(wait=hang)], cancelled=begun.is_set)
    finally:
        release.set()


def test_at_the_deadline_the_best_known_action_is_the_answer_and_the_rest_is_accounted_for():
    late = threading.Event()
    release = threading.Event()

    def hang(call: int) -> None:
        if call >= 5:
            late.set()
            release.wait(10)

    try:
        result = run(
            [FakeModel(wait=hang)],
            evaluations=20,
            in_flight=2,
            deadline_s=1.0,
            clock=lambda: 1.0 if late.is_set() else 0.0,
        )
    finally:
        release.set()
    finished = [trial for trial in result.trials if trial.reward is not None]
    unfinished = [trial for trial in result.trials if trial.reward is None]
    assert [trial.index for trial in result.trials] == list(range(len(result.trials)))
    assert 4 <= len(finished) <= 5
    assert 1 <= len(unfinished) <= 2
    assert all("deadline" in trial.error for trial in unfinished)
    assert result.reward == max(trial.reward for trial in finished if trial.reward is not None)


def test_a_deadline_before_the_first_answer_is_an_error():
    release = threading.Event()
    try:
        with pytest.raises(TimedOutError, match="deadline_s"):
            run([FakeModel(wait=lambda call: release.wait(10))], deadline_s=0.05)
    finally:
        release.set()


@pytest.mark.parametrize(
    ("options", "complaint"),
    [
        ({"evaluations": 0}, "evaluations: expected 1 to 5000, got 0"),
        ({"evaluations": 10**6}, "evaluations: expected 1 to 5000, got 1000000"),
        ({"in_flight": 0}, "in_flight: expected 1 to 64, got 0"),
        ({"d_max": float("nan")}, "d_max: expected a number above 0 and at most 1, got nan"),
        ({"d_max": 1.5}, "d_max: expected a number above 0 and at most 1"),
        ({"seed": -1}, "seed: expected 0 or more"),
        ({"deadline_s": 0.0}, "deadline_s: expected a time above 0"),
        ({"strategy": "best"}, "strategy: expected one of"),
    ],
)
def test_options_out_of_range_are_refused_before_any_model_is_asked(options: dict[str, object], complaint: str):
    model = FakeModel()
    with pytest.raises(RequestError, match=complaint):
        run([model], **options)
    assert model.calls == 0
