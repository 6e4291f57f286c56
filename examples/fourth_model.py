"""A model of your own in one file, joining a running system:

    frugal serve model examples/fourth_model.py:RestingModel

From then on `frugal workers` lists it, and `frugal optimize SCENE --strategy only:resting` asks it for every outcome.
Without an MDE it is used only when it is named: nobody knows yet where it can be trusted.
"""

import numpy as np
from numpy.typing import NDArray

from common.domain.grid import Floats
from common.domain.heightmap import shift
from common.domain.model import PredictiveModel
from common.domain.scene import State


class RestingModel(PredictiveModel):
    """A stiff item that stays level: it rests on the highest thing below it, and nothing gives way."""

    name = "resting"
    version = "1"
    largest_batch = 256

    def outcomes(self, state: State, actions: NDArray[np.float64]) -> tuple[Floats, tuple[str, ...]]:
        """Return the level placements ``(B, H, W)`` [m] of actions ``(B, 2)`` [m]."""
        return np.stack([self._outcome(state, action) for action in actions]), ("",) * len(actions)

    def _outcome(self, state: State, action: NDArray[np.float64]) -> Floats:
        item = shift(state.item.heights, *(action / state.grid.cell))
        covered = item > 0.5 * state.item.heights.max()
        if not covered.any():
            return state.scene.heights
        support = state.scene.heights[covered].max()
        return np.where(covered, support + item, state.scene.heights)
