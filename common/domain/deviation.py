"""Deviation between predictions, and estimators of it (MDEs)."""

from abc import ABC, abstractmethod
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from common.domain.errors import ModelError
from common.domain.grid import Floats
from common.domain.model import Event, check_actions
from common.domain.scene import State


def deviation(prediction: Floats, other: Floats) -> NDArray[np.float64]:
    """Return ``d(P, Q)``, the mean absolute height difference over the grid [m].

    Args:
        prediction: ``(..., H, W)`` [m].
        other: ``(..., H, W)`` [m], broadcast against ``prediction``.
    """
    difference = np.asarray(prediction, dtype=np.float64) - np.asarray(other, dtype=np.float64)
    return np.abs(difference).mean(axis=(-2, -1))


@dataclass(frozen=True)
class Estimates:
    """Estimated deviations of a batch of actions, scaled to [0, 1] as ``d_max`` is.

    Attributes:
        mean: Expected deviation ``(B,)``.
        upper: Calibrated upper bound ``(B,)``; equal to ``mean`` for an estimator without one.
        familiar: Whether state and action resemble the training data ``(B,)`` bool.
        reason: In what the unfamiliar ones differ from the training data, empty if all are familiar.
        instance: The worker that answered, ``local`` in this process.
        compute_s: Time that the estimator took [s]; None if nobody measured it.
        events: What went wrong on the way.
        scale_m: The deviation that counts as 1 [m]; None if the estimator does not say.
        version: Version of the MDE that gave them, empty if it does not say.
    """

    mean: NDArray[np.float64]
    upper: NDArray[np.float64]
    familiar: NDArray[np.bool_]
    reason: str = ""
    instance: str = "local"
    compute_s: float | None = None
    events: tuple[Event, ...] = ()
    scale_m: float | None = None
    version: str = ""


class DeviationEstimator(ABC):
    """An MDE ``m(s_0, a)``: how far a fast model will be from the trusted one.

    Attributes:
        takes: As in `PredictiveModel`.
    """

    model: str
    version: str
    largest_batch: int = 4096
    takes: tuple[tuple[str, ...], ...] = (("x", "y"),)

    @abstractmethod
    def deviations(self, state: State, actions: NDArray[np.float64]) -> Estimates:
        """Return the estimates for actions ``(B, n)``."""

    def estimate(self, state: State, actions: Floats) -> Estimates:
        """Estimate the deviation of every action.

        Raises:
            RequestError: ``actions`` is not ``(B, n)`` of finite numbers, exceeds ``largest_batch``, or has other
                parameters than the MDE takes.
            ModelError: The estimator returned something of the wrong shape or not finite.
        """
        checked = check_actions(actions, self.largest_batch, self.takes)
        estimates = self.deviations(state, checked)
        for name in ("mean", "upper", "familiar"):
            values = getattr(estimates, name)
            if values.shape != (len(checked),) or not np.isfinite(values).all():
                raise ModelError(f"MDE of {self.model}: expected {len(checked)} finite numbers as {name}, got {values}")
        return estimates if estimates.version else replace(estimates, version=self.version)
