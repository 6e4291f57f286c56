"""Find plate and fries in a scene of which only heightmap and masks are known."""

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import binary_dilation, label

from common.domain.bodies import ROUNDING, Bodies, Box, Material, Plate
from common.domain.errors import ModelError
from common.domain.grid import Grid
from common.domain.scene import Scene
from services.simulator.perception_boxes import Array, axes, fit_boxes, soft_tops
from services.simulator.perception_plate import fit_plate
from services.simulator.perception_search import guess_boxes

MOST_BOXES = 40
EXPLAINED = 2.5e-3
"""A cell is explained where the boxes' surface is this near, or where an edge passes by [m]."""
LEAST_SCORE = 9.0
LEAST_GAIN = 0.02
"""A box is dropped where the differences [m], added over the cells, grow by less than this without it."""


def find_bodies(scene: Scene) -> Bodies:
    """Find the plate and the fries that explain a heightmap; hidden fries cannot be found.

    The boxes are near rest but not at rest: let them settle before they are used.

    Raises:
        ModelError: The plate is not a surface of revolution, or there are more fries than can be told apart.
    """
    plate = fit_plate(scene)
    ground = plate.heightmap(scene.grid)
    pieces, count = label(scene.materials[0] > 0, structure=np.ones((3, 3)))
    boxes: list[Box] = []
    for piece in range(1, count + 1):
        found = _find_boxes(scene, ground, pieces == piece)
        boxes += _as_boxes(scene, plate, found)
    if len(boxes) > MOST_BOXES:
        raise ModelError(f"expected at most {MOST_BOXES} fries, got {len(boxes)}")
    return Bodies(plate, tuple(boxes))


def _find_boxes(scene: Scene, ground: Array, piece: NDArray[np.bool_]) -> Array:
    """Return the parameters of the boxes ``(K, 8)`` that explain one connected piece of the fries' mask."""
    grid, heights = scene.grid, scene.heights.astype(np.float64)
    guesses = guess_boxes(grid, heights, ground, piece)
    region = binary_dilation(piece, np.ones((3, 3)), iterations=max(1, round(0.004 / grid.cell)))
    region &= piece | (scene.materials[0] == 0)
    points, seen, floor = _points(grid, region), heights[region], ground[region]
    boxes = np.zeros((0, 8))
    for _ in range(2):
        while len(boxes) <= MOST_BOXES and len(guesses.boxes):
            unexplained = np.zeros(grid.shape, dtype=bool)
            unexplained[region] = ~_explained(boxes, points, seen, floor, grid.cell)
            index, score = guesses.best((unexplained & piece).ravel())
            if score < LEAST_SCORE:
                break
            below = np.maximum(floor, soft_tops(boxes, points, floor, grid.cell).max(axis=0, initial=-np.inf))
            near = np.hypot(*(points - guesses.boxes[index, :2]).T) < 0.045
            new = fit_boxes(
                guesses.boxes[index : index + 1], points[near], seen[near], below[near], grid.cell, iterations=6
            )
            boxes = np.concatenate([boxes, new])
        if len(boxes):
            boxes = fit_boxes(boxes, points, seen, floor, grid.cell, iterations=10)
            boxes = _drop_idle(boxes, points, seen, floor, grid.cell)
    return boxes


def _explained(boxes: Array, points: Array, seen: Array, floor: Array, cell: float) -> NDArray[np.bool_]:
    """Return where the boxes' surface is what is seen, or where it jumps within a cell ``(N,)``."""
    if not len(boxes):
        return np.abs(seen - floor) < EXPLAINED
    tops = [soft_tops(boxes, points, floor, blur).max(axis=0) for blur in (cell / 100, cell, 3 * cell)]
    low, high = np.min(tops, axis=0), np.max(tops, axis=0)
    return (seen > low - EXPLAINED) & (seen < high + EXPLAINED)


def _drop_idle(boxes: Array, points: Array, seen: Array, floor: Array, cell: float) -> Array:
    """Drop, one by one, boxes without which the heightmap is explained as well."""
    while len(boxes):
        tops = np.concatenate([soft_tops(boxes, points, floor, cell), floor[None]])
        total = np.abs(tops.max(axis=0) - seen).sum()
        gains = [np.abs(np.delete(tops, i, axis=0).max(axis=0) - seen).sum() - total for i in range(len(boxes))]
        worst = int(np.argmin(gains))
        if gains[worst] * (cell / 0.003) ** 2 > LEAST_GAIN:
            break
        boxes = np.delete(boxes, worst, axis=0)
    return boxes


def _as_boxes(scene: Scene, plate: Plate, boxes: Array) -> list[Box]:
    """Return boxes with the material seen at their upper faces; one that lies on the plate is as thick as it is high."""
    grid = scene.grid
    tops = np.array([soft_tops(box, _points(grid, np.ones(grid.shape, bool)), np.zeros(1), grid.cell) for box in boxes])
    materials = scene.materials.reshape(3, -1)
    found: list[Box] = []
    for box, top, frame in zip(boxes, tops, axes(boxes), strict=True):
        length, width = max(box[6], 4 * ROUNDING), max(box[7], 4 * ROUNDING)
        above = box[2] - float(plate.height(np.hypot(box[0], box[1])))
        level = np.abs(box[4:6]).max() < 0.03
        thickness = above if level and 0.7 * width < above < 1.3 * width else width
        visible = (top >= tops.max(axis=0)) & (top > 0) & (materials[0] > 0)
        nearest = np.hypot(*(_points(grid, materials[0].reshape(grid.shape) > 0) - box[:2]).T).argmin()
        density, modulus, ratio = (
            np.median(materials[:, visible], axis=1) if visible.any() else materials[:, materials[0] > 0][:, nearest]
        )
        found.append(
            Box(
                np.array([length, width, thickness]),
                box[:3] - frame[2] * thickness / 2,
                _quaternion(frame.T),
                Material(float(density), float(modulus), float(ratio)),
            )
        )
    return found


def _points(grid: Grid, mask: NDArray[np.bool_]) -> Array:
    """Return the centres of the cells of a mask ``(N, 2)`` [m]."""
    rows, columns = np.nonzero(mask)
    return np.stack([grid.x[columns], grid.y[rows]], axis=1)


def _quaternion(rotation: Array) -> Array:
    """Return the unit quaternion ``(x, y, z, w)`` of a rotation matrix: the null vector of a symmetric matrix."""
    (a, b, c), (d, e, f), (g, h, i) = rotation
    symmetric = np.array(
        [
            [a - e - i, b + d, c + g, h - f],
            [b + d, e - a - i, f + h, c - g],
            [c + g, f + h, i - a - e, d - b],
            [h - f, c - g, d - b, a + e + i],
        ]
    )
    return np.linalg.eigh(symmetric)[1][:, -1]
