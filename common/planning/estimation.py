"""Estimates for the actions that are asked together: each MDE is asked once, about all of them."""

import threading
from collections import defaultdict
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from common.domain.deviation import DeviationEstimator, Estimates
from common.domain.errors import FrugalError, ModelError, TimedOutError, UnavailableError
from common.domain.model import Event
from common.domain.scene import State
from common.planning.strategy import Estimate

RECOVERABLE = (ModelError, UnavailableError, TimedOutError)
"""Failures of one model or MDE that another one may make good."""


@dataclass(frozen=True)
class Consultation:
    """What one evaluation learned from an MDE, and what that cost.

    Attributes:
        estimate: The estimate for its action; None if the MDE failed.
        compute_s: Time that the MDE took [s]; 0 where another evaluation of the round had asked already.
        transport_s: The rest of the time until the answer was there [s].
        events: What went wrong on the way, told to the evaluation that asked; their times mean nothing yet.
    """

    estimate: Estimate | None
    compute_s: float = 0.0
    transport_s: float = 0.0
    events: tuple[Event, ...] = ()


class Round:
    """A round of actions ``(B, n)``; safe to use from the threads that evaluate them.

    An MDE is asked when the first evaluation needs it, in one batch for the whole round; the others wait for that
    answer. An MDE that fails has failed for the whole round.

    Args:
        state: Scene and item.
        actions: The actions of the round ``(B, n)`` [m].
        estimators: MDEs by the name of their model.
        now: Seconds since the optimisation began.
    """

    def __init__(
        self,
        state: State,
        actions: NDArray[np.float64],
        estimators: Mapping[str, DeviationEstimator],
        *,
        now: Callable[[], float],
    ) -> None:
        self._state = state
        self._actions = actions
        self._estimators = estimators
        self._now = now
        self._turns: defaultdict[str, threading.Lock] = defaultdict(threading.Lock)
        self._lock = threading.Lock()
        self._answers: dict[str, tuple[Estimate | None, ...]] = {}

    def consult(self, model: str, position: int) -> Consultation:
        """Return what the MDE of a model says about the action at a position of the round.

        Raises:
            RequestError: The MDE refused the request.
            CancelledError: The optimisation has ended meanwhile.
        """
        with self._lock:
            turn = self._turns[model]
        with turn:
            known = self._answers.get(model)
            if known is not None:
                return Consultation(known[position])
            began = self._now()
            compute_s: float | None = None
            try:
                parts = self._ask(self._estimators[model])
            except RECOVERABLE as error:
                self._answers[model] = (None,) * len(self._actions)
                events: tuple[Event, ...] = (failure_event(error, f"mde/{model}"),)
            else:
                self._answers[model] = tuple(estimate for part in parts for estimate in _singles(part))
                events = tuple(event for part in parts for event in _events(part, f"mde/{model}"))
                if all(part.compute_s is not None for part in parts):
                    compute_s = sum(part.compute_s or 0.0 for part in parts)
            wall_s = self._now() - began
            compute_s = wall_s if compute_s is None else min(compute_s, wall_s)
            return Consultation(self._answers[model][position], compute_s, wall_s - compute_s, events)

    def _ask(self, estimator: DeviationEstimator) -> Sequence[Estimates]:
        size = estimator.largest_batch
        starts = range(0, len(self._actions), size)
        return [estimator.estimate(self._state, self._actions[start : start + size]) for start in starts]


def failure_event(error: FrugalError, worker: str) -> Event:
    """Return the event that a model or an MDE has failed."""
    return Event("model_error" if isinstance(error, ModelError) else error.code, worker, str(error))


def unfamiliar_event(estimates: Estimates, worker: str) -> Event:
    """Return the event that an MDE does not know what it was asked about."""
    return Event("unfamiliar", worker, estimates.reason or "unlike what the MDE learned from")


def _singles(estimates: Estimates) -> list[Estimate]:
    return [
        Estimate(float(mean), float(upper), bool(familiar), estimates.version)
        for mean, upper, familiar in zip(estimates.mean, estimates.upper, estimates.familiar, strict=True)
    ]


def _events(estimates: Estimates, worker: str) -> tuple[Event, ...]:
    if estimates.familiar.all():
        return estimates.events
    return (*estimates.events, unfamiliar_event(estimates, worker))
