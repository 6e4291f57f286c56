"""Transport: what one outcome of the trusted model says about the outcomes of nearby actions."""

from abc import ABC, abstractmethod
from typing import Any

import numpy as np
from numpy.typing import NDArray

Window = tuple[slice, slice]
"""Rows and columns of a heightmap."""


class Transport(ABC):
    """A model of nearby actions, made from one action and its outcome; at that action it gives that outcome back.

    Attributes:
        outcome: The outcome ``(H, W)`` [m].
    """

    outcome: NDArray[np.float32]

    @abstractmethod
    def window(self, actions: NDArray[np.float64]) -> Window:
        """Return where the outcomes of actions ``(B, n)`` may differ from the known one."""

    @abstractmethod
    def patches(
        self, actions: NDArray[np.float64], window: Window, shared: dict[Any, Any] | None = None
    ) -> NDArray[np.float32]:
        """Return the heights ``(B, h, w)`` [m] that actions ``(B, n)`` lead to in a window that contains theirs.

        Args:
            actions: The actions.
            window: The window.
            shared: Where transports of one state keep what is the same for all of them with these actions and window.
        """

    @abstractmethod
    def distances(self, actions: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return how far from its place here each action ``(B, n)`` puts what is moved ``(B,)`` [m]."""

    @abstractmethod
    def aligned(self) -> NDArray[np.float32]:
        """Return the heights of what was moved, in its own frame ``(p,)`` [m]: the same points for every outcome."""

    def outcomes(self, actions: NDArray[np.float64]) -> NDArray[np.float32]:
        """Return the heightmaps ``(B, H, W)`` [m] that actions ``(B, n)`` would lead to."""
        window = self.window(actions)
        moved = np.repeat(self.outcome[None], len(actions), axis=0)
        moved[:, window[0], window[1]] = self.patches(actions, window)
        return moved
