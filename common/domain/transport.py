"""Transport: what one outcome of the trusted model says about the outcomes of nearby actions."""

from abc import ABC, abstractmethod

import numpy as np
from numpy.typing import NDArray

from common.domain.deviation import deviation
from common.domain.grid import Floats


class Transport(ABC):
    """A model of nearby actions, made from one action and its outcome; at that action it gives that outcome back."""

    @abstractmethod
    def outcomes(self, actions: NDArray[np.float64]) -> NDArray[np.float32]:
        """Return the heightmaps ``(B, H, W)`` [m] that actions ``(B, n)`` would lead to."""

    @abstractmethod
    def errors(self, actions: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return how far off the reward of each action ``(B, n)`` may be, one standard deviation ``(B,)`` [m]."""

    def rewards(self, actions: NDArray[np.float64], target: Floats) -> NDArray[np.float64]:
        """Return ``-d(P(a), s_g)`` [m] of actions ``(B, n)`` for a target ``(H, W)``, shape ``(B,)``."""
        return -deviation(self.outcomes(actions), target)
