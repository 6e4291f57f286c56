"""Laws of an interrupted optimisation: resumed, it ends as if nothing had happened, and nothing is paid for twice."""

import threading
from contextlib import suppress
from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray
from test_strategies import ALL, Draping, Even, Result, State, run

from common.domain.errors import CancelledError
from common.planning.evaluation import Evaluation
from services.heuristic import HeuristicModel


class Noting(Draping):
    """The trusted model, which notes what it was asked, and calls back with the number of each question."""

    def __init__(self, on_call=lambda call: None) -> None:
        super().__init__()
        self.on_call = on_call
        self.asked: list[tuple[float, ...]] = []

    def outcomes(self, state: State, actions: NDArray[np.float64]):
        with self.lock:
            self.asked += [tuple(action.tolist()) for action in actions]
            call = len(self.asked)
        self.on_call(call)
        return super().outcomes(state, actions)


class Kept(dict[int, Evaluation]):
    """Evaluations as a shell would keep them."""

    def __call__(self, evaluation: Evaluation) -> None:
        self[evaluation.trial.index] = evaluation


def evidence(result: Result):
    """Return what must not depend on an interruption."""
    timeless = [replace(trial, started_s=0.0, predict_s=0.0, compute_s=0.0) for trial in result.trials]
    return timeless, result.action, result.reward, result.heights.tobytes(), result.usage, result.models


def resume(strategy: str, kept: Kept, *, in_flight: int):
    simulator, more = Noting(), Kept()
    result = run(strategy, [HeuristicModel(), simulator], in_flight=in_flight, seed=5, earlier=kept, on_evaluation=more)
    return result, simulator.asked, more


@pytest.mark.parametrize("strategy", ALL)
@pytest.mark.parametrize("in_flight", [1, 4])
@pytest.mark.parametrize("last_call", [1, 3, 6])
def test_a_run_that_was_stopped_anywhere_ends_as_if_it_had_not_been(strategy: str, in_flight: int, last_call: int):
    undisturbed = run(strategy, [HeuristicModel(), Draping()], in_flight=in_flight, seed=5)
    stopped, kept = threading.Event(), Kept()
    first = Noting(lambda call: stopped.set() if call >= last_call else None)
    options = {"in_flight": in_flight, "seed": 5, "on_evaluation": kept, "cancelled": stopped.is_set}
    with suppress(CancelledError):
        run(strategy, [HeuristicModel(), first], **options)
    known = Kept(kept)
    result, asked, more = resume(strategy, known, in_flight=in_flight)
    assert evidence(result) == evidence(undisturbed)
    assert not {evaluation.trial.action for evaluation in known.values()} & set(asked)
    assert sorted([*known, *more]) == [trial.index for trial in result.trials]
    assert not any(event.kind == "not_resumed" for event in result.events)


@pytest.mark.parametrize("strategy", ALL)
@pytest.mark.parametrize("in_flight", [1, 4])
def test_evaluations_that_ended_out_of_order_are_used_too(strategy: str, in_flight: int):
    kept = Kept()
    undisturbed = run(strategy, [HeuristicModel(), Draping()], in_flight=in_flight, seed=5, on_evaluation=kept)
    known = Kept({index: evaluation for index, evaluation in kept.items() if index not in (1, 4, 5)})
    result, _, more = resume(strategy, known, in_flight=in_flight)
    assert evidence(result) == evidence(undisturbed)
    assert sorted(more) == sorted(kept.keys() & {1, 4, 5})


@pytest.mark.parametrize("strategy", ALL)
def test_a_run_that_was_nearly_over_asks_the_trusted_model_nothing(strategy: str):
    kept = Kept()
    undisturbed = run(strategy, [HeuristicModel(), Draping()], seed=5, on_evaluation=kept)
    result, asked, _ = resume(strategy, kept, in_flight=1)
    assert evidence(result) == evidence(undisturbed)
    assert asked == []


@pytest.mark.parametrize("strategy", ALL)
def test_with_other_cheap_models_the_run_goes_on_and_takes_no_answer_for_that_to_another_question(strategy: str):
    kept = Kept()
    run(strategy, [HeuristicModel(), Draping()], [Even()], seed=5, on_evaluation=kept)
    simulator = Noting()
    result = run(strategy, [simulator], [], seed=5, earlier=kept)
    used = [trial.index in kept and trial.action == kept[trial.index].trial.action for trial in result.trials]
    assert simulator.asked == [trial.action for trial, is_used in zip(result.trials, used, strict=True) if not is_used]
    misfits = any(trial.index in kept and not is_used for trial, is_used in zip(result.trials, used, strict=True))
    assert {event.kind for event in result.events} == ({"not_resumed"} if misfits else set())
    assert result.reward == max(trial.reward for trial in result.trials if trial.reward is not None)
