"""Which cells of a heightmap show food: the place for a segmenter of your own, one that sees colours for instance."""

from abc import ABC, abstractmethod

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import distance_transform_edt
from skimage.feature import peak_local_max
from skimage.filters import apply_hysteresis_threshold
from skimage.measure import label
from skimage.morphology import disk, opening, remove_small_holes, remove_small_objects
from skimage.segmentation import watershed

from common.domain.grid import Floats, Grid


class Segmenter(ABC):
    """Tells food from plate, and pieces of food from one another."""

    @abstractmethod
    def segment(self, rise: Floats, grid: Grid) -> NDArray[np.int64]:
        """Return the number of the piece that each cell shows, 0 for none ``(H, W)``.

        Args:
            rise: Heights above the empty plate ``(H, W)`` [m].
            grid: Their grid.
        """


class HeightSegmenter(Segmenter):
    """Food is what rises above the plate; pieces are parted where they are narrow (watershed of the distance).

    Args:
        least: What rises by less everywhere is noise [m].
        lowest: Down to this height a piece goes on [m].
        smallest: Area below which a piece is noise [m2].
        rim: Where the plate is steep, so that a small shift looks like a ring: from here on pieces are opened [m].
    """

    def __init__(
        self, *, least: float = 0.0045, lowest: float = 0.0025, smallest: float = 1.2e-4, rim: float = 0.110
    ) -> None:
        self._least = least
        self._lowest = lowest
        self._smallest = smallest
        self._rim = rim

    def segment(self, rise: Floats, grid: Grid) -> NDArray[np.int64]:
        """Return the pieces, numbered from 1."""
        cells = max(1, round(self._smallest / grid.cell**2))
        mask = apply_hysteresis_threshold(rise, self._lowest, self._least)
        radius = np.hypot(grid.x[None, :], grid.y[:, None])
        steep = opening(mask, disk(max(1, round(0.008 / grid.cell))))
        mask = np.where(radius < self._rim, mask, steep)
        mask = remove_small_holes(remove_small_objects(mask, max_size=cells - 1), max_size=cells)
        distance = np.asarray(distance_transform_edt(mask))
        peaks = peak_local_max(distance, min_distance=max(1, round(0.010 / grid.cell)), labels=label(mask))
        markers = np.zeros(grid.shape, dtype=np.int64)
        markers[tuple(peaks.T)] = np.arange(1, len(peaks) + 1)
        return np.asarray(watershed(-distance, markers, mask=mask), dtype=np.int64)
