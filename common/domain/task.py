"""A task: what an action means, and how good its outcome is."""

from abc import ABC, abstractmethod

import numpy as np
from numpy.typing import NDArray

from common.domain.deviation import deviation
from common.domain.grid import Floats
from common.domain.scene import State
from common.domain.transport import Transport


class Task(ABC):
    """One family of action selection problems.

    Attributes:
        name: The word in the keys.
        trusted: The model that is always applicable.
    """

    name: str
    trusted: str

    @abstractmethod
    def bounds(self, state: State) -> NDArray[np.float64]:
        """Return the smallest and largest value of each action parameter ``(n, 2)``."""

    def transport(self, state: State, action: NDArray[np.float64], outcome: Floats) -> Transport | None:
        """Return what the outcome ``(H, W)`` [m] of an action ``(n,)`` says about nearby actions; None: nothing."""
        return None

    def reward(self, prediction: Floats, target: Floats) -> NDArray[np.float64]:
        """Return ``r(s_T, s_g) = -d(s_T, s_g)`` [m] for predictions ``(..., H, W)`` and a target ``(H, W)``."""
        return -deviation(prediction, target)
