"""The grid of a heightmap: rows along y, columns along x, both increasing, the plate's centre as origin."""

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from common.domain.errors import RequestError

Floats = NDArray[np.floating[Any]]

MAX_CELLS = 1024 * 1024


def _hammersley(bits: int) -> NDArray[np.float64]:
    """Return ``2^bits`` points in a unit square about 0, each alone in its row and column ``(K, 2)``."""
    count = 1 << bits
    reversed_bits = [int(f"{number:0{bits}b}"[::-1], 2) for number in range(count)]
    return (np.column_stack([np.arange(count), reversed_bits]) + 0.5) / count - 0.5


SUBSAMPLES = _hammersley(6)
"""Where a cell is sampled for its mean height, x and y from its centre in cells ``(K, 2)``.

A heightmap holds means over its cells: an edge that moves by a fraction of a cell changes the heights by that fraction.
"""


@dataclass(frozen=True)
class Grid:
    """A regular grid of square cells, centred on the plate.

    Attributes:
        rows: Number of cells along y, ``H``.
        columns: Number of cells along x, ``W``.
        cell: Edge of a cell [m].
    """

    rows: int = 96
    columns: int = 96
    cell: float = 0.003

    def __post_init__(self) -> None:
        if self.rows < 2 or self.columns < 2 or self.rows * self.columns > MAX_CELLS:
            raise RequestError(
                f"expected a grid of at least 2 x 2 and at most {MAX_CELLS} cells, got {self.rows} x {self.columns}"
            )
        if not 1e-5 <= self.cell <= 1.0:
            raise RequestError(f"expected a cell between 1e-5 and 1 m, got {self.cell}")

    @property
    def shape(self) -> tuple[int, int]:
        """``(H, W)``."""
        return self.rows, self.columns

    @property
    def x(self) -> NDArray[np.float64]:
        """Centres of the columns ``(W,)`` [m]."""
        return (np.arange(self.columns, dtype=np.float64) - (self.columns - 1) / 2) * self.cell

    @property
    def y(self) -> NDArray[np.float64]:
        """Centres of the rows ``(H,)`` [m]."""
        return (np.arange(self.rows, dtype=np.float64) - (self.rows - 1) / 2) * self.cell

    @property
    def half_extent(self) -> tuple[float, float]:
        """Distance from the origin to the outer edges along x and y [m]."""
        return self.columns * self.cell / 2, self.rows * self.cell / 2


def check_heightmap(name: str, heights: Floats, grid: Grid) -> NDArray[np.float32]:
    """Return ``heights`` as a read-only float32 ``(H, W)`` array, or raise `RequestError`."""
    checked = _check_array(name, heights, grid.shape)
    if float(np.abs(checked).max()) > 1.0:
        raise RequestError(f"{name}: expected heights of at most 1 m, got {float(np.abs(checked).max()):g} m")
    return checked


def check_materials(name: str, materials: Floats, grid: Grid) -> NDArray[np.float32]:
    """Return ``materials`` as a read-only float32 ``(3, H, W)`` array, or raise `RequestError`.

    The channels are density [kg/m3], Young's modulus [Pa] and Poisson's ratio [-] of the topmost thing.
    """
    checked = _check_array(name, materials, (3, *grid.shape))
    if float(checked.min()) < 0:
        raise RequestError(f"{name}: expected material properties of 0 or more, got {float(checked.min()):g}")
    if float(checked[2].max()) >= 0.5:
        raise RequestError(f"{name}: expected Poisson's ratios below 0.5, got {float(checked[2].max()):g}")
    return checked


def _check_array(name: str, values: Floats, shape: tuple[int, ...]) -> NDArray[np.float32]:
    if values.shape != shape:
        raise RequestError(f"{name}: expected shape {shape}, got {values.shape}")
    checked = np.array(values, dtype=np.float32)
    bad = int(checked.size - np.isfinite(checked).sum())
    if bad:
        raise RequestError(f"{name}: expected finite numbers, got {bad} that are NaN or infinite")
    checked.flags.writeable = False
    return checked
