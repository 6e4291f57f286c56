"""A task: what an action means, and how good its outcome is."""

from abc import ABC, abstractmethod

import numpy as np
from numpy.typing import NDArray

from common.domain.deviation import deviation
from common.domain.grid import Floats
from common.domain.scene import State


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

    def reward(self, prediction: Floats, target: Floats) -> NDArray[np.float64]:
        """Return ``r(s_T, s_g) = -d(s_T, s_g)`` [m] for predictions ``(..., H, W)`` and a target ``(H, W)``."""
        return -deviation(prediction, target)
