"""Where an item is put: on flat plate, on fries, over the rim."""

import numpy as np
from numpy.typing import NDArray

from common.domain.grid import Floats, Grid
from common.domain.heightmap import shift
from common.tasks.plating import FLAT_RADIUS

REGIONS = ("flat", "fries", "rim", "fries_and_rim")


def region(grid: Grid, scene_materials: Floats, item_heights: Floats, action: NDArray[np.float64]) -> str:
    """Return the one of `REGIONS` that lies below the item, had it not moved or bent.

    Args:
        grid: The grid.
        scene_materials: Materials of the scene ``(3, H, W)``; what has one is a fry.
        item_heights: The item, centred ``(H, W)`` [m].
        action: Where its centre is put ``(2,)`` [m].
    """
    below = shift((item_heights > 0).astype(np.float32), *(action / grid.cell)) > 0.5
    on_fries = bool((scene_materials[0][below] > 0).any())
    on_rim = bool((np.hypot(grid.x[None, :], grid.y[:, None])[below] > FLAT_RADIUS).any())
    return {(False, False): "flat", (True, False): "fries", (False, True): "rim"}.get(
        (on_fries, on_rim), "fries_and_rim"
    )
