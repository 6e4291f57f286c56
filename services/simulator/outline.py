"""The item as its heightmap gives it: thickness and material over the plane."""

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from common.domain.grid import Floats, Grid
from common.domain.scene import Item

POISSON_LIMIT = 0.49
"""Poisson's ratio above which elements lock [-]; softer contrasts are capped here."""


@dataclass(frozen=True)
class Outline:
    """An item in its own frame: the grid's centre is the origin, the underside is z = 0.

    Its area is the union of the heightmap's covered cells ("pixels").

    Attributes:
        thickness: Height of each pixel, 0 outside, one empty pixel around ``(R, C)`` [m].
        materials: Density, Young's modulus, Poisson's ratio of each pixel ``(3, R, C)``.
        corner: Lower left corner of the first pixel ``(2,)`` [m].
        pixel: Edge of a pixel [m].
    """

    thickness: NDArray[np.float64]
    materials: NDArray[np.float64]
    corner: NDArray[np.float64]
    pixel: float

    @property
    def covered(self) -> NDArray[np.bool_]:
        """Where the item is ``(R, C)``."""
        return self.thickness > 0

    @property
    def centres(self) -> NDArray[np.float64]:
        """Centres of the covered pixels, row by row ``(P, 2)`` [m]."""
        rows, columns = np.nonzero(self.covered)
        return self.corner + (np.stack([columns, rows], axis=1) + 0.5) * self.pixel

    @cached_property
    def lattice(self) -> NDArray[np.float64]:
        """Thickness at the pixels' corners, the mean of the covered pixels around ``(R + 1, C + 1)`` [m]."""
        total = _around(self.thickness)
        count = _around(self.covered.astype(np.float64))
        return np.where(count > 0, total / np.maximum(count, 1), 0.0)

    @property
    def boundary(self) -> NDArray[np.intp]:
        """Corners of pixels (row, column) between covered and empty ones ``(Q, 2)``."""
        count = _around(self.covered.astype(np.float64))
        return np.argwhere((count > 0) & (count < 4))

    def locate(self, points: Floats) -> tuple[NDArray[np.intp], NDArray[np.intp], NDArray[np.bool_]]:
        """Return row and column of the pixel that holds each point ``(P, 2)`` [m], and whether it is covered."""
        cells = np.floor((points - self.corner) / self.pixel).astype(np.intp)
        rows, columns = cells[:, 1], cells[:, 0]
        inside = (rows >= 0) & (rows < self.thickness.shape[0]) & (columns >= 0) & (columns < self.thickness.shape[1])
        rows, columns = np.where(inside, rows, 0), np.where(inside, columns, 0)
        return rows, columns, inside & self.covered[rows, columns]


def outline_of(item: Item, grid: Grid) -> Outline:
    """Cut the item out of its grid."""
    rows, columns = np.nonzero(item.outline)
    low_row, low_column = int(rows.min()), int(columns.min())
    window = (slice(low_row, int(rows.max()) + 1), slice(low_column, int(columns.max()) + 1))
    thickness = np.pad(item.heights[window].astype(np.float64), 1)
    materials = np.pad(item.materials[(slice(None), *window)].astype(np.float64), ((0, 0), (1, 1), (1, 1)))
    materials[2] = np.minimum(materials[2], POISSON_LIMIT)
    corner = np.array([grid.x[low_column], grid.y[low_row]]) - 1.5 * grid.cell
    return Outline(thickness, materials, corner, grid.cell)


def _around(values: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the sum of the four pixels around each corner."""
    padded = np.pad(values, 1)
    return padded[:-1, :-1] + padded[1:, :-1] + padded[:-1, 1:] + padded[1:, 1:]
