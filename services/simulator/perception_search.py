"""First guesses of the fries in a piece of the heightmap: boxes of the standard size that explain many cells."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from common.domain.grid import Grid
from services.simulator.perception_boxes import LENGTH, WIDTH, Array

YAWS = np.arange(24) * np.pi / 24
ALONG = np.linspace(-0.45, 0.45, 19) * LENGTH
ACROSS = np.array([-0.25, 0.0, 0.25]) * WIDTH
PAIRS = [(i, j) for i in range(0, 19, 3) for j in range(i + 6, 19, 3)]
TOLERANCE = 1.6e-3
STEEPEST = 1.3
LOWEST = 5e-3
"""An upper face lies at least this far above the plate [m]."""


@dataclass(frozen=True)
class Guesses:
    """Boxes of the standard size that agree with the heightmap where they can be seen.

    Attributes:
        boxes: Parameters ``(K, 8)``, see `services.simulator.perception_boxes`.
        cells: Flat index of the cell under each of the box's sample points ``(K, P)``.
        agrees: Whether the box's upper face is what is seen at that point ``(K, P)``.
        penalty: Points that stick out of the heightmap, and neighbours at the same height ``(K,)``.
    """

    boxes: Array
    cells: NDArray[np.int64]
    agrees: NDArray[np.bool_]
    penalty: Array

    def best(self, unexplained: NDArray[np.bool_], untried: NDArray[np.bool_]) -> tuple[int, float]:
        """Return index and score of the untried ``(K,)`` guess that explains most of the cells ``(H * W,)``."""
        fresh = (self.agrees & unexplained[self.cells]).sum(axis=1)
        seen = self.agrees.sum(axis=1)
        score = fresh + 0.25 * (seen - fresh) - self.penalty - np.where((fresh < 6) | ~untried, np.inf, 0.0)
        index = int(score.argmax())
        return index, float(score[index])


def guess_boxes(grid: Grid, heights: Array, plate: Array, mask: NDArray[np.bool_]) -> Guesses:
    """Return the best slope and height for every centre in ``mask`` and every direction.

    Args:
        grid: The grid.
        heights: Heightmap ``(H, W)`` [m].
        plate: Bare plate ``(H, W)`` [m].
        mask: Cells that may hold a centre ``(H, W)``.
    """
    rows, columns = np.nonzero(mask)
    stride = max(1, round(2 * 0.003 / grid.cell))
    chosen = (rows + columns) % stride == 0 if grid.cell > 0.002 else (rows % stride == 0) & (columns % stride == 0)
    if not chosen.any():
        chosen[:] = True
    rows, columns = rows[chosen], columns[chosen]
    centre = np.stack(np.broadcast_arrays(grid.x[columns, None], grid.y[rows, None], YAWS[None]), -1).reshape(-1, 3)
    cells = _lookup(grid, centre, ALONG, ACROSS)  # (K, 19, 3)
    seen = heights.ravel()[cells]
    floor = plate.ravel()[cells[:, ::9, 1]]  # at the ends and the centre
    middle = np.median(seen, axis=2)
    best_score = np.full(len(centre), -np.inf)
    best_line = np.zeros((len(centre), 2))
    for i, j in PAIRS:
        slope = (middle[:, j] - middle[:, i]) / (ALONG[j] - ALONG[i])
        level = middle[:, i] - slope * ALONG[i]
        excess = seen - (level[:, None] + slope[:, None] * ALONG)[..., None]
        score = (np.abs(excess) < TOLERANCE).sum(axis=(1, 2)) - 1.0 * (excess < -TOLERANCE).sum(axis=(1, 2))
        ends = level[:, None] + slope[:, None] * ALONG[::9]
        score[(ends < floor + LOWEST).any(axis=1) | (np.abs(slope) > STEEPEST)] = -np.inf
        better = score > best_score
        best_score[better] = score[better]
        best_line[better] = np.stack([level, slope], axis=1)[better]
    kept = best_score > 8
    centre, cells, seen, best_line = centre[kept], cells[kept], seen[kept], best_line[kept]
    level, slope = best_line.T
    excess = seen - (level[:, None] + slope[:, None] * ALONG)[..., None]
    beside = heights.ravel()[_lookup(grid, centre, ALONG[1::2], np.array([-0.9, 0.9]) * WIDTH)]
    level_beside = (level[:, None] + slope[:, None] * ALONG[1::2])[..., None]
    penalty = 1.0 * (excess < -TOLERANCE).sum(axis=(1, 2)) + 0.5 * (np.abs(beside - level_beside) < TOLERANCE).sum(
        (1, 2)
    )
    size, points = len(centre), len(ALONG) * len(ACROSS)
    boxes = np.column_stack(
        [centre[:, :2], level, centre[:, 2], slope, np.zeros(size), np.full(size, LENGTH), np.full(size, WIDTH)]
    )
    return Guesses(boxes, cells.reshape(size, points), (np.abs(excess) < TOLERANCE).reshape(size, points), penalty)


def _lookup(grid: Grid, centre: Array, along: Array, across: Array) -> NDArray[np.int64]:
    """Return the flat index of the cell under each point of a lattice turned about each centre ``(K, A, C)``."""
    cos, sin = np.cos(centre[:, 2])[:, None, None], np.sin(centre[:, 2])[:, None, None]
    x = centre[:, 0, None, None] + cos * along[:, None] - sin * across
    y = centre[:, 1, None, None] + sin * along[:, None] + cos * across
    columns = np.rint((x - grid.x[0]) / grid.cell).astype(np.int64).clip(0, grid.columns - 1)
    rows = np.rint((y - grid.y[0]) / grid.cell).astype(np.int64).clip(0, grid.rows - 1)
    return rows * grid.columns + columns
