"""The heuristic model: Algorithm 1 of the paper."""

import numpy as np
from numpy.typing import NDArray

from common.domain.grid import Floats
from common.domain.heightmap import shift
from common.domain.model import PredictiveModel
from common.domain.scene import State


class HeuristicModel(PredictiveModel):
    """Add the item's heightmap, shifted by the action, to the scene: ``I = I_0 + shift(I_obj, a)``.

    The shift is bilinear between cells and exact at whole cells.
    """

    name = "heuristic"
    version = "1"
    largest_batch = 4096

    def outcomes(self, state: State, actions: NDArray[np.float64]) -> tuple[Floats, tuple[str, ...]]:
        """Return the sums ``(B, H, W)`` [m]."""
        moved = np.stack([shift(state.item.heights, *(action / state.grid.cell)) for action in actions])
        return state.scene.heights + moved, ("",) * len(actions)
