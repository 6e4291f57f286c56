"""The loop: ask for actions, evaluate several at a time, tell their outcomes, answer with the best."""

import math
import time
from collections import Counter, deque
from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import Future, wait
from dataclasses import dataclass, replace
from threading import Event as Flag
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

from common.domain.certificate import Certificate
from common.domain.deviation import DeviationEstimator
from common.domain.errors import CancelledError, FrugalError, RequestError, TimedOutError, UnavailableError
from common.domain.model import Event, PredictiveModel
from common.domain.trial import Result, Trial
from common.planning.evaluation import Evaluation, Evaluator, elapsed_s
from common.planning.plan import Outcome, Plan, Setting
from common.planning.problem import Problem
from common.planning.selection import DEFAULT, parse_strategy
from common.planning.strategy import Strategy
from common.planning.sweep import Sweeps
from common.planning.threads import Threads

T = TypeVar("T")

MOST_EVALUATIONS = 5000
MOST_IN_FLIGHT = 64
HOPELESS = 3
"""An optimisation whose first evaluations all failed is given up after this many."""
POLL_S = 0.02
"""How often a cancellation is looked for [s]."""


def optimize(
    problem: Problem,
    models: Mapping[str, PredictiveModel],
    estimators: Mapping[str, DeviationEstimator],
    *,
    strategy: str | Strategy = DEFAULT,
    d_max: float = 0.4,
    evaluations: int = 50,
    in_flight: int = 1,
    seed: int = 0,
    trusted: str | None = None,
    deadline_s: float | None = None,
    clock: Callable[[], float] = time.perf_counter,
    on_trial: Callable[[Trial], None] | None = None,
    cancelled: Callable[[], bool] | None = None,
    earlier: Mapping[int, Evaluation] | None = None,
    on_evaluation: Callable[[Evaluation], None] | None = None,
) -> Result:
    """Find the action with the best predicted reward.

    Outcomes are told to the strategy's plan in the order of asking, and action n is asked as soon as the outcomes of
    actions 0 to n - ``in_flight`` are known. So the trials depend on the seed and ``in_flight`` alone, not on which
    answer happened to come first. Actions that are asked before anything has to be waited for are a round: each MDE
    is asked about all of them at once, and each goes to the models that the strategy names. What a plan asks of cheap
    models in sweeps is counted in ``usage`` and ``split_s``; it is no trial, and an answer only where a deadline
    leaves no other.

    An outcome with a warning, for instance ``not_settled``, counts like any other: its reward is the best that is
    known of the action, and the warning stays with the trial.

    A run that was interrupted is resumed by the same call with what ``on_evaluation`` was told: the plan asks the same
    actions again and nobody is asked for what is known. Only sweeps are repeated. An earlier evaluation of another
    action, or by another version of its model, is made anew, which is an event ``not_resumed``. The clock goes on
    where the last earlier evaluation ended; a deadline counts from there, so that what is known is never lost to it.

    Args:
        problem: What is to be optimised.
        models: Models by name, from cheapest to dearest; `PredictiveModel.predict` is called from several threads.
        estimators: MDEs by the name of their model.
        strategy: Which actions are evaluated, and which model answers, see `parse_strategy`;
            also one of the caller's own.
        d_max: Deviation below which a model is applicable, scaled to [0, 1].
        evaluations: Number of actions to evaluate, for a strategy that stops by itself the largest; failed ones count.
        in_flight: Largest number of evaluations at the same time.
        seed: Seed of every random choice.
        trusted: The model that is always applicable; the task's own if None.
        deadline_s: Answer with the best action known after this time [s]: the best that was evaluated, else the best
            of the sweeps. Evaluations that still run are trials without model and reward; nobody waits for them, nor
            for a plan that still computes.
        clock: Seconds since any fixed moment, for time stamps.
        on_trial: Called with every trial, in the order of asking.
        cancelled: Whether the caller has lost interest; asked about every 20 ms.
        earlier: Evaluations of an interrupted run of the same optimisation, by index.
        on_evaluation: Called with every new evaluation as soon as it is known, from several threads and in any order.

    Raises:
        RequestError: An option is out of range or unknown, or a model refused the request.
        UnavailableError: The model that the strategy needs is missing or nobody serves it any more.
        CancelledError: ``cancelled`` said so.
        TimedOutError: The deadline came before the first answer.
        FrugalError: The first three evaluations, or all of them, failed: the last one's error.
    """
    _check_options(d_max=d_max, evaluations=evaluations, in_flight=in_flight, seed=seed, deadline_s=deadline_s)
    chosen = parse_strategy(strategy) if isinstance(strategy, str) else strategy
    trusted = problem.task.trusted if trusted is None else trusted
    required = chosen.required(trusted)
    if required not in models:
        raise UnavailableError(
            f"strategy {chosen.name}: expected the model {required}, got {', '.join(models) or 'no model'}"
        )
    earlier = {} if earlier is None else earlier
    passed_s = elapsed_s(earlier)
    deadline_s = None if deadline_s is None else deadline_s + passed_s
    start, stop = clock() - passed_s, Flag()

    def now() -> float:
        return clock() - start

    evaluator = Evaluator(
        problem=problem,
        models=models,
        estimators=estimators,
        strategy=chosen,
        trusted=trusted,
        d_max=d_max,
        seed=seed,
        now=now,
        stopped=stop.is_set,
        earlier=earlier,
        on_evaluation=on_evaluation,
    )
    pool = Threads(in_flight + 1, name="evaluation")  # one for the plan and its sweeps

    def wait_for(function: Callable[[], T]) -> T:
        future = pool.submit(function)
        if not _finished(future, now=now, deadline_s=deadline_s, cancelled=cancelled):
            raise _DeadlineError
        return future.result()

    def sweep(question: Callable[[], T]) -> T:
        if stop.is_set():
            raise CancelledError("the optimisation has ended")
        return question()

    try:
        sweeps = Sweeps(problem, models, estimators, now=now, wait_for=sweep)
        budget = chosen.budget(evaluations)
        plan = chosen.plan(Setting(problem, tuple(models), trusted, budget, seed, sweeps))
        record = _Record(plan, sweeps, now=now, on_trial=on_trial)
        late, certificate = False, None
        running: deque[_Running] = deque()
        asked: list[tuple[int, NDArray[np.float64]]] = []
        try:
            for count in range(budget + in_flight):
                if count >= in_flight and (running or asked):
                    if not running or not running[0].future.done():
                        running += _started(asked, evaluator, pool)
                        asked.clear()
                    if not _finished(running[0].future, now=now, deadline_s=deadline_s, cancelled=cancelled):
                        raise _DeadlineError
                    record.settle(running.popleft())
                if count < budget and (action := wait_for(record.ask)) is not None:
                    asked.append(action)
            certificate = wait_for(record.certificate)
        except _DeadlineError:
            late = True
        running += [_Running(index, action, now(), Future()) for index, action in asked]
        for left in running:
            if left.future.done() and left.future.exception() is None:
                record.settle(left, is_told=False)  # the plan may still be computing
            else:
                record.abandon(left)
        return record.result(strategy=chosen.name, seed=seed, in_flight=in_flight, late=late, certificate=certificate)
    finally:
        stop.set()
        pool.stop()


class _DeadlineError(Exception):
    """The deadline came while the plan computed or an evaluation ran."""


@dataclass(frozen=True)
class _Running:
    """An evaluation whose reward is not told yet."""

    index: int
    action: NDArray[np.float64]
    started_s: float
    future: Future[Evaluation]


def _started(asked: Sequence[tuple[int, NDArray[np.float64]]], evaluator: Evaluator, pool: Threads) -> list[_Running]:
    """Start the evaluations of a round."""
    if not asked:
        return []
    together = evaluator.round(np.stack([action for _, action in asked]))
    return [
        _Running(index, action, evaluator.now(), pool.submit(evaluator.evaluate, index, action, together, position))
        for position, (index, action) in enumerate(asked)
    ]


class _Record:
    """What has happened so far."""

    def __init__(
        self, plan: Plan, sweeps: Sweeps, *, now: Callable[[], float], on_trial: Callable[[Trial], None] | None
    ) -> None:
        self._plan = plan
        self._sweeps = sweeps
        self._asked = 0
        self._now = now
        self._on_trial = on_trial
        self._trials: list[Trial] = []
        self._events: list[Event] = []
        self._split = {"mde": 0.0, "optimiser": 0.0, "transport": 0.0}
        self._best: tuple[Trial, NDArray[np.float32]] | None = None
        self._failure: FrugalError | None = None

    def ask(self) -> tuple[int, NDArray[np.float64]] | None:
        """Return the next index and action; None if the plan wants no more for now."""
        action = self._own_time(self._plan.ask)
        if action is None:
            return None
        self._asked += 1
        return self._asked - 1, action

    def certificate(self) -> Certificate | None:
        """Return the plan's certificate."""
        return self._own_time(self._plan.certificate)

    def _own_time(self, question: Callable[[], T]) -> T:
        """Ask the plan; it waits for its sweeps, the rest of the time is its own."""
        began, swept_s = self._now(), sum(self._sweeps.split_s.values())
        answer = question()
        self._split["optimiser"] += max(self._now() - began - (sum(self._sweeps.split_s.values()) - swept_s), 0.0)
        return answer

    def settle(self, running: _Running, *, is_told: bool = True) -> None:
        """Keep the evidence, and tell it to the plan if ``is_told``.

        Raises:
            FrugalError: The evaluation failed for good, or it was the last of the first few and all of them failed.
        """
        evaluation = running.future.result()
        trial, began = evaluation.trial, self._now()
        outcome = None
        if trial.reward is not None and evaluation.heights is not None:
            outcome = Outcome(trial.model, trial.reward, evaluation.heights)
        if is_told:
            self._plan.tell(trial.index, outcome)
        self._split["optimiser"] += self._now() - began
        for name, seconds in evaluation.split_s.items():
            self._split[name] = self._split.get(name, 0.0) + seconds
        self._events += [event for event in evaluation.events if self._is_new(event)]
        if trial.reward is None or evaluation.heights is None:
            self._failure = evaluation.failure
        elif self._best is None or trial.reward > _reward(self._best[0]):
            self._best = trial, evaluation.heights
        self._keep(trial)
        if self._best is None and self._failure is not None and len(self._trials) == HOPELESS:
            raise self._failure

    def abandon(self, running: _Running) -> None:
        """Keep an evaluation that failed or that nobody waits for any more, at the deadline."""
        error = "timed_out: not finished at the deadline"
        failure = running.future.exception() if running.future.done() else None
        if isinstance(failure, FrugalError):
            error = f"{failure.code}: {failure}"
        self._keep(
            Trial(
                index=running.index,
                action=tuple(running.action.tolist()),
                model="",
                instance="",
                version="",
                reward=None,
                started_s=running.started_s,
                predict_s=self._now() - running.started_s,
                error=error,
            )
        )

    def result(
        self, *, strategy: str, seed: int, in_flight: int, late: bool, certificate: Certificate | None
    ) -> Result:
        """Return the answer; ``late``, at the deadline, a cheap model's if no evaluation has one.

        Raises:
            FrugalError: There is none.
        """
        swept = self._sweeps
        if self._best is None and late and swept.best is not None:
            cheap, heights = swept.best
            self._best = replace(cheap, index=len(self._trials)), heights
            self._keep(self._best[0])
        if self._best is None:
            raise self._failure or TimedOutError("deadline_s: expected time for one evaluation at least, none finished")
        best, heights = self._best
        swept_s, usage = dict(swept.split_s), Counter(dict(swept.usage))  # copies: an abandoned plan may still sweep
        for name, seconds in swept_s.items():
            self._split[name] = self._split.get(name, 0.0) + seconds
        return Result(
            action=best.action,
            reward=_reward(best),
            heights=heights,
            trials=tuple(self._trials),
            usage=dict(Counter(trial.model for trial in self._trials if trial.model) + usage),
            models=dict(swept.versions)
            | {trial.model: trial.version for trial in self._trials if trial.version}
            | self._mde_versions(),
            split_s=self._split,
            wall_s=self._now(),
            events=tuple(sorted((*self._events, *swept.events), key=lambda event: event.time)),
            strategy=strategy,
            seed=seed,
            in_flight=in_flight,
            certificate=certificate,
        )

    def _mde_versions(self) -> dict[str, str]:
        found = {model: dict(versions) for model, versions in self._sweeps.mdes.items()}
        for trial in self._trials:
            for model, version in trial.mdes.items():
                found.setdefault(model, {})[version] = None
        return {f"mde/{model}": ", ".join(versions) for model, versions in found.items()}

    def _is_new(self, event: Event) -> bool:
        """Return whether an event has to be kept; of those that tend to repeat only the first of each worker."""
        return event.kind not in ("unfamiliar", "not_resumed") or all(
            (event.kind, event.worker) != (known.kind, known.worker) for known in self._events
        )

    def _keep(self, trial: Trial) -> None:
        self._trials.append(trial)
        if self._on_trial is not None:
            self._on_trial(trial)


def _reward(trial: Trial) -> float:
    return -math.inf if trial.reward is None else trial.reward


def _finished(
    future: Future[T],
    *,
    now: Callable[[], float],
    deadline_s: float | None,
    cancelled: Callable[[], bool] | None,
) -> bool:
    """Wait for an evaluation; return False if the deadline came first.

    Raises:
        CancelledError: The caller has lost interest.
    """
    while True:
        if cancelled is not None and cancelled():
            raise CancelledError("the caller cancelled the optimisation")
        left = math.inf if deadline_s is None else deadline_s - now()
        if future.done() and left > 0:
            return True
        if left <= 0:
            return False
        wait([future], timeout=min(POLL_S, left))


def _check_options(*, d_max: float, evaluations: int, in_flight: int, seed: int, deadline_s: float | None) -> None:
    if not 1 <= evaluations <= MOST_EVALUATIONS:
        raise RequestError(f"evaluations: expected 1 to {MOST_EVALUATIONS}, got {evaluations}")
    if not 1 <= in_flight <= MOST_IN_FLIGHT:
        raise RequestError(f"in_flight: expected 1 to {MOST_IN_FLIGHT}, got {in_flight}")
    if not 0 < d_max <= 1:
        raise RequestError(f"d_max: expected a number above 0 and at most 1, got {d_max}")
    if seed < 0:
        raise RequestError(f"seed: expected 0 or more, got {seed}")
    if deadline_s is not None and not 0 < deadline_s < math.inf:
        raise RequestError(f"deadline_s: expected a time above 0, got {deadline_s}")
