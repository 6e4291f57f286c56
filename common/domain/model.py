"""Predictive models: from a state and actions to the heightmaps that they lead to."""

from abc import ABC, abstractmethod
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from common.domain.errors import ModelError, RequestError
from common.domain.grid import Floats
from common.domain.scene import State


@dataclass(frozen=True)
class Event:
    """Something that went wrong on the way to an answer, kept with the result.

    Attributes:
        kind: ``no_reply``, ``timed_out``, ``busy``, ``model_error``, ``joined``, ``left``, ...
        worker: Whom it happened to, ``<model>/<instance>``.
        detail: One sentence.
        time: Seconds since the optimisation began [s].
    """

    kind: str
    worker: str
    detail: str
    time: float = 0.0


@dataclass(frozen=True)
class Predictions:
    """The outcomes of a batch of actions, and who computed them.

    Attributes:
        heights: Predicted heightmaps ``(B, H, W)`` float32 [m].
        warnings: Per action what to know about its outcome, empty if nothing (``not_settled: 4 mm/s``).
        model: Name of the model that answered.
        version: Its version.
        instance: The worker that answered, ``local`` in this process.
        compute_s: Time that the model took, without transport and waiting [s]; None if nobody measured it.
        events: What went wrong on the way.
    """

    heights: NDArray[np.float32]
    warnings: tuple[str, ...]
    model: str
    version: str
    instance: str = "local"
    compute_s: float | None = None
    events: tuple[Event, ...] = ()


class PredictiveModel(ABC):
    """A model ``f(s_0, a) -> s_T``: one state, a batch of actions.

    A subclass sets ``name`` and ``version``, and computes in `outcomes`; the base checks both sides.

    Attributes:
        takes: The action parameters that it understands, one tuple of names for each form; empty: any.
    """

    name: str
    version: str
    largest_batch: int = 64
    takes: tuple[tuple[str, ...], ...] = (("x", "y"),)

    @abstractmethod
    def outcomes(self, state: State, actions: NDArray[np.float64]) -> tuple[Floats, tuple[str, ...]]:
        """Return heightmaps ``(B, H, W)`` [m] and a warning per action (empty: none) for actions ``(B, n)``."""

    def predict(self, state: State, actions: Floats) -> Predictions:
        """Predict the outcome of every action.

        Raises:
            RequestError: ``actions`` is not ``(B, n)`` of finite numbers, exceeds ``largest_batch``, or has other
                parameters than the model takes.
            ModelError: The model returned something of the wrong shape or not finite.
        """
        checked = check_actions(actions, self.largest_batch, self.takes)
        heights, warnings = self.outcomes(state, checked)
        expected = (len(checked), *state.grid.shape)
        heights = np.asarray(heights, dtype=np.float32)
        if heights.shape != expected or len(warnings) != len(checked):
            raise ModelError(
                f"{self.name}: expected heightmaps {expected} and {len(checked)} warnings, "
                f"got {heights.shape} and {len(warnings)}"
            )
        if not np.isfinite(heights).all():
            raise ModelError(f"{self.name}: expected finite heights, got NaN or infinite ones")
        return Predictions(heights, warnings, self.name, self.version)


def check_actions(actions: Floats, largest_batch: int, takes: tuple[tuple[str, ...], ...] = ()) -> NDArray[np.float64]:
    """Return actions as float64 ``(B, n)``, or raise `RequestError`; ``takes`` as in `PredictiveModel`."""
    checked = np.array(actions, dtype=np.float64)
    if checked.ndim != 2 or not 1 <= len(checked) <= largest_batch:
        raise RequestError(f"actions: expected shape (B, n) with B from 1 to {largest_batch}, got {checked.shape}")
    check_parameters(checked.shape[1], takes)
    if not np.isfinite(checked).all():
        raise RequestError("actions: expected finite numbers, got NaN or infinite ones")
    return checked


def check_parameters(count: int, takes: tuple[tuple[str, ...], ...]) -> None:
    """Raise `RequestError` if no form of an action has so many parameters; an empty ``takes`` allows any number."""
    if takes and count not in {len(names) for names in takes}:
        forms = " or ".join(f"{len(names)} ({', '.join(names)})" for names in takes)
        raise RequestError(f"actions: expected {forms} parameters each, got {count}")
