"""Depth images to heightmaps: back-project the pixels, sort the points into cells, fill what the camera did not see."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from common.domain.camera import Camera
from common.domain.errors import RequestError
from common.domain.grid import Floats, Grid

SAME_SURFACE = 0.005
"""Neighbouring pixels are on one surface where their depths differ by less than this [m]."""
LEAST_NEIGHBOURS = 3
"""Pixels with fewer neighbours on their surface lie between two surfaces: an edge bleeds."""
PARTS = 3
"""Parts of a cell along each axis; their heights are averaged."""
POINTS = 1.5
"""Points that a part should get: larger pixels are cut up."""
MOST_CUTS = 6
LEAST_MEASURED = 0.6

Vectors = NDArray[np.float64]


@dataclass(frozen=True)
class Measured:
    """A heightmap from a depth image.

    Attributes:
        heights: ``(H, W)`` [m], holes filled.
        is_measured: Where the camera saw something ``(H, W)``.
    """

    heights: NDArray[np.float32]
    is_measured: NDArray[np.bool_]


def heightmap_from_depth(depth: Floats, camera: Camera, grid: Grid) -> Measured:
    """Return the heightmap that a depth image shows: the mean height over each cell.

    Pixels between two surfaces are dropped, and pixels that are large for the grid are cut up. Each part of a cell
    takes the median of its points. A part that the camera did not see takes the height of the first parts that it did
    see further away along its line of sight: what hides behind an object is most often what the object stands on.

    Args:
        depth: Distances along the camera's z axis ``(h, w)`` [m]; 0 or not finite where there is none.
        camera: The camera.
        grid: The grid to draw on.

    Raises:
        RequestError: The image is empty, or shows less than `LEAST_MEASURED` of the grid.
    """
    if depth.ndim != 2 or min(depth.shape) < 3:
        raise RequestError(f"depth: expected an image (h, w) of at least 3 x 3 pixels, got {depth.shape}")
    seen = np.where(np.isfinite(depth) & (depth > 0), depth, np.nan).astype(np.float64)
    seen[~_is_surface(seen)] = np.nan
    cuts = _cuts(_on_grid(camera.points(seen), grid), grid)
    fine = Grid(grid.rows * PARTS, grid.columns * PARTS, grid.cell / PARTS)
    heights = _medians(_on_grid(camera.points(seen, cuts=cuts), grid), fine)
    shape = (grid.rows, PARTS, grid.columns, PARTS)
    is_measured = np.asarray(np.isfinite(heights).reshape(shape).any(axis=(1, 3)))
    if is_measured.mean() < LEAST_MEASURED:
        raise RequestError(
            f"depth: expected at least {LEAST_MEASURED:.0%} of the grid's cells in the image, got "
            f"{is_measured.mean():.0%}: check intrinsics, pose and the unit of the depths"
        )
    filled = _fill_shadows(_fill_specks(heights), fine, camera.position[:2])
    means = filled.reshape(shape).mean(axis=(1, 3))
    return Measured(means.astype(np.float32), is_measured)


def surface_points(depth: Floats, camera: Camera) -> Vectors:
    """Return the points of all pixels that lie on a surface ``(N, 3)`` [m], not between two."""
    seen = np.where(np.isfinite(depth) & (depth > 0), depth, np.nan).astype(np.float64)
    kept = _is_surface(seen)
    return camera.points(seen)[kept].reshape(-1, 3)


def _is_surface(depth: Vectors) -> NDArray[np.bool_]:
    """Return which pixels have enough neighbours on the same surface ``(h, w)``."""
    padded = np.pad(depth, 1, constant_values=np.nan)
    height, width = depth.shape
    near = np.zeros(depth.shape, dtype=np.int64)
    for row in range(3):
        for column in range(3):
            if (row, column) != (1, 1):
                near += np.abs(padded[row : row + height, column : column + width] - depth) < SAME_SURFACE
    return near >= LEAST_NEIGHBOURS


def _on_grid(points: Vectors, grid: Grid) -> Vectors:
    """Return the known points that lie on the grid ``(N, 3)``."""
    points = points.reshape(-1, 3)
    half_x, half_y = grid.half_extent
    return points[(np.abs(points[:, 0]) < half_x) & (np.abs(points[:, 1]) < half_y)]


def _cuts(points: Vectors, grid: Grid) -> int:
    """Return into how many parts along each axis pixels are to be cut, so that each part of a cell gets its points."""
    counts = np.zeros(grid.shape, dtype=np.int64)
    np.add.at(counts, _cells(points, grid), 1)
    seen = counts[counts > 0]
    return int(np.clip(np.ceil(PARTS * np.sqrt(POINTS / np.median(seen))), 1, MOST_CUTS)) if seen.size else 1


def _cells(points: Vectors, grid: Grid) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    half_x, half_y = grid.half_extent
    rows = ((points[:, 1] + half_y) / grid.cell).astype(np.int64).clip(0, grid.rows - 1)
    columns = ((points[:, 0] + half_x) / grid.cell).astype(np.int64).clip(0, grid.columns - 1)
    return rows, columns


def _medians(points: Vectors, grid: Grid) -> Vectors:
    """Return the median height of the points in each cell ``(H, W)`` [m], NaN where there is none."""
    cells = np.ravel_multi_index(_cells(points, grid), grid.shape)
    order = np.lexsort((points[:, 2], cells))
    found, first, count = np.unique(cells[order], return_index=True, return_counts=True)
    sorted_heights = points[order, 2]
    medians = (sorted_heights[first + (count - 1) // 2] + sorted_heights[first + count // 2]) / 2
    heights = np.full(grid.shape, np.nan)
    heights.ravel()[found] = medians
    return heights


def _fill_specks(heights: Vectors) -> Vectors:
    """Fill cells with at least five known neighbours by their median."""
    filled = heights.copy()
    padded = np.pad(heights, 1, constant_values=np.nan)
    rows, columns = np.nonzero(np.isnan(heights))
    around = np.stack([padded[rows + row, columns + column] for row in range(3) for column in range(3)], axis=1)
    enough = np.isfinite(around).sum(axis=1) >= 5
    filled[rows[enough], columns[enough]] = np.nanmedian(around[enough], axis=1)
    return filled


def _fill_shadows(heights: Vectors, grid: Grid, foot: Vectors) -> Vectors:
    """Fill each unknown cell with the median of the first three known ones on the way from ``foot``, or back to it."""
    filled = heights.copy()
    for sign in (1, -1):
        rows, columns = np.nonzero(np.isnan(filled))
        if not rows.size:
            break
        direction = np.stack([grid.x[columns] - foot[0], grid.y[rows] - foot[1]], axis=1)
        direction *= sign / np.maximum(np.linalg.norm(direction, axis=1, keepdims=True), 1e-9)
        met = np.full((len(rows), 3), np.nan)
        count = np.zeros(len(rows), dtype=np.int64)
        for step in range(1, grid.rows + grid.columns):
            along = (
                np.rint(rows + step * direction[:, 1]).astype(int),
                np.rint(columns + step * direction[:, 0]).astype(int),
            )
            inside = (
                (along[0] >= 0) & (along[0] < grid.rows) & (along[1] >= 0) & (along[1] < grid.columns) & (count < 3)
            )
            if not inside.any():
                break
            values = np.full(len(rows), np.nan)
            values[inside] = heights[along[0][inside], along[1][inside]]
            hit = np.isfinite(values)
            met[hit, count[hit]] = values[hit]
            count += hit
        known = count > 0
        filled[rows[known], columns[known]] = np.nanmedian(met[known], axis=1)
    return np.where(np.isnan(filled), np.nanmedian(heights), filled)
