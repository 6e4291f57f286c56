"""What an interrupted optimisation had found out, and what becomes of it."""

from dataclasses import replace

import pytest
from planning_fakes import FakeModel, small_problem

from common.domain.errors import ModelError, TimedOutError
from common.domain.trial import Result
from common.planning.evaluation import Evaluation, elapsed_s
from common.planning.optimize import optimize

PROBLEM = small_problem()


class Clock:
    """Stands still, except while a model computes: each prediction takes a second."""

    def __init__(self) -> None:
        self.time = 500.0

    def __call__(self) -> float:
        return self.time

    def tick(self, call: int) -> None:
        self.time += 1.0


def run(model: FakeModel, *, clock: Clock | None = None, **options) -> Result:
    clock = Clock() if clock is None else clock
    model.wait = clock.tick
    options = {"strategy": "threshold", "evaluations": 6, **options}
    return optimize(PROBLEM, {model.name: model}, {}, clock=clock, **options)


def known(model: FakeModel, *, first: int) -> dict[int, Evaluation]:
    kept: list[Evaluation] = []
    run(model, on_evaluation=kept.append)
    return {evaluation.trial.index: evaluation for evaluation in kept[:first]}


def test_every_evaluation_is_told_as_soon_as_it_is_known():
    kept: list[Evaluation] = []
    told: list[int] = []
    result = run(FakeModel(), on_evaluation=kept.append, on_trial=lambda trial: told.append(len(kept)))
    assert [evaluation.trial for evaluation in kept] == list(result.trials)
    assert all(count >= number for number, count in enumerate(told, 1))


def test_the_clock_goes_on_where_the_last_known_evaluation_ended():
    earlier = known(FakeModel(), first=4)
    assert elapsed_s(earlier) == 4.0
    result = run(FakeModel(), earlier=earlier)
    assert [trial.started_s for trial in result.trials] == [0.0, 1.0, 2.0, 3.0, 4.0, 5.0]
    assert result.wall_s == 6.0
    assert result.split_s["simulator"] == pytest.approx(6.0)


def test_a_deadline_counts_from_the_resumption():
    result = run(FakeModel(), earlier=known(FakeModel(), first=4), deadline_s=0.5)
    assert [trial.started_s for trial in result.trials] == [0.0, 1.0, 2.0, 3.0, 4.0]


def test_a_failure_is_known_too():
    error = TimedOutError("too long")
    earlier = known(FakeModel(error=error, fails=lambda call: call == 1), first=3)
    model = FakeModel()
    result = run(model, earlier=earlier)
    assert [trial.reward is None for trial in result.trials] == [False, True, False, False, False, False]
    assert result.trials[1].error == "timed_out: too long"
    assert model.calls == 3


def test_three_failures_at_the_beginning_are_given_up_after_an_interruption_too():
    model = FakeModel(error=ModelError("broken"))
    kept: list[Evaluation] = []
    with pytest.raises(ModelError):
        run(model, on_evaluation=kept.append)
    with pytest.raises(ModelError, match="broken"):
        run(model, earlier={evaluation.trial.index: evaluation for evaluation in kept[:2]})
    assert model.calls == 4


def test_another_version_of_the_model_is_asked_anew_and_that_is_said_once():
    earlier, newer = known(FakeModel(), first=4), FakeModel(version="4")
    result = run(newer, earlier=earlier)
    assert newer.calls == 6
    (event,) = result.events
    assert (event.kind, event.worker) == ("not_resumed", "simulator/local")
    assert event.detail == "evaluation 0: expected version 3 of simulator, got 4"
    assert result.models == {"simulator": "4"}


def test_what_is_known_of_another_action_is_not_used():
    earlier = known(FakeModel(), first=3)
    moved = replace(earlier[1], trial=replace(earlier[1].trial, action=(0.01, 0.02), reward=0.0))
    model = FakeModel()
    result = run(model, earlier={**earlier, 1: moved})
    assert model.calls == 4
    assert (0.01, 0.02) not in [trial.action for trial in result.trials]
    assert "expected the action (0.01, 0.02) of the interrupted run" in result.events[0].detail
