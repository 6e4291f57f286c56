"""The space that actions are chosen from: bounds in different units, some of them closed to circles."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from common.planning.gp import Float64s
from common.planning.problem import Problem


@dataclass(frozen=True)
class Space:
    """Actions within bounds. A parameter whose bounds span its whole period is a circle.

    Attributes:
        limits: Smallest and largest value of each parameter ``(n, 2)``.
        circular: Which parameters are circles ``(n,)``.
    """

    limits: Float64s
    circular: NDArray[np.bool_]

    @classmethod
    def of(cls, problem: Problem) -> "Space":
        """Return the space of a problem."""
        spans = np.ptp(problem.limits, axis=1)
        periods = np.array([parameter.period or np.inf for parameter in problem.task.parameters])
        return cls(problem.limits, spans >= periods * (1 - 1e-9))

    def gaps(self, actions: Float64s, others: Float64s) -> Float64s:
        """Return ``actions - others`` ``(..., n)``, the short way round where a parameter is a circle."""
        gaps = np.asarray(actions - others, dtype=np.float64)
        if self.circular.any():
            spans = np.ptp(self.limits, axis=1)
            gaps = np.where(self.circular, (gaps + spans / 2) % spans - spans / 2, gaps)
        return gaps

    def confine(self, actions: Float64s) -> Float64s:
        """Return actions ``(..., n)`` moved to the nearest that is within the limits, on circles to the same one."""
        low, high = self.limits[:, 0], self.limits[:, 1]
        clipped = np.clip(actions, low, high)
        if self.circular.any():
            return np.where(self.circular, low + (actions - low) % (high - low), clipped)
        return clipped


def embed(shares: Float64s, circular: NDArray[np.bool_]) -> Float64s:
    """Return coordinates for distances ``(..., n')``: a circle of circumference 1 becomes two, the others stay.

    A kernel of the Euclidean distance in these is a kernel on the circle: small distances are those along it, opposite
    points are ``1 / pi`` apart.

    Args:
        shares: Actions as shares of the range ``(..., n)``.
        circular: Which parameters are circles ``(n,)``.
    """
    if not circular.any():
        return shares
    angle = 2 * np.pi * shares[..., circular]
    return np.concatenate([shares[..., ~circular], np.cos(angle) / (2 * np.pi), np.sin(angle) / (2 * np.pi)], axis=-1)
