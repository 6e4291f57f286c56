"""Find plate and fries in a scene of which only heightmap and masks are known."""

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import binary_dilation, label

from common.domain.bodies import ROUNDING, Bodies, Box, Material, Plate
from common.domain.errors import ModelError
from common.domain.grid import Grid
from common.domain.scene import Scene
from services.simulator.perception_boxes import Array, axes, overlaps, soft_tops
from services.simulator.perception_contact import rest_thicknesses
from services.simulator.perception_fit import View, fit_boxes, level_boxes, stretch_box
from services.simulator.perception_plate import fit_plate
from services.simulator.perception_search import guess_boxes

MOST_BOXES = 40
EXPLAINED = 2.5e-3
"""A cell is explained where the boxes' surface is this near, or where an edge passes by [m]."""
MOST_FAILURES = 3
"""A search ends after so many guesses that did not fit once they had been fitted."""
LEAST_SCORE = 9.0
LEAST_GAIN = 3e-7
"""A box is needed where it explains at least this volume, about a twentieth of a fry [m3]."""
MOST_OVERLAP = 0.4
"""A box that lies inside another one by more than this share needs ten times the reason [-]."""


def find_bodies(scene: Scene) -> Bodies:
    """Find the plate and the fries that explain a heightmap; hidden fries cannot be found.

    The boxes are near rest but not at rest: let them settle before they are used.

    Raises:
        ModelError: The plate is not a surface of revolution, or there are more fries than can be told apart.
    """
    plate = fit_plate(scene)
    ground = plate.heightmap(scene.grid)
    pieces = np.zeros(scene.grid.shape, dtype=np.int32)
    label(scene.materials[0] > 0, structure=np.ones((3, 3)), output=pieces)
    boxes: list[Box] = []
    for piece in range(1, int(pieces.max()) + 1):
        found = _find_boxes(scene, ground, pieces == piece)
        boxes += _as_boxes(scene, plate, found) if len(found) else []
    if len(boxes) > MOST_BOXES:
        raise ModelError(f"expected at most {MOST_BOXES} fries, got {len(boxes)}")
    return Bodies(plate, tuple(boxes))


def _find_boxes(scene: Scene, ground: Array, piece: NDArray[np.bool_]) -> Array:
    """Return the parameters of the boxes ``(K, 8)`` that explain one connected piece of the fries' mask.

    The guess that explains most cells is added and fitted, until nothing is left to explain; then all are fitted
    together, those that nobody needs are dropped, and the rest of the cells gets a second chance.
    """
    grid, heights = scene.grid, scene.heights.astype(np.float64)
    guesses = guess_boxes(grid, heights, ground, piece)
    region = binary_dilation(piece, np.ones((3, 3)), iterations=max(1, round(0.004 / grid.cell)))
    region &= piece | (scene.materials[0] == 0)
    view = View(_points(grid, region), heights[region], ground[region], grid.cell)
    boxes, untried = np.zeros((0, 8)), np.ones(len(guesses.boxes), dtype=bool)
    for _ in range(2):
        surfaces, failures = _surfaces(boxes, view), 0
        while len(boxes) < MOST_BOXES and failures < MOST_FAILURES and untried.any():
            unexplained = np.zeros(grid.shape, dtype=bool)
            unexplained[region] = ~_explained(surfaces, view)
            index, score = guesses.best((unexplained & piece).ravel(), untried)
            if score < LEAST_SCORE:
                break
            untried[index] = False
            nearby = view.near(guesses.boxes[index], ground=surfaces[1])
            new = fit_boxes(guesses.boxes[index : index + 1], nearby, blur=3.0, iterations=4)
            new = fit_boxes(stretch_box(new, nearby), nearby, blur=1.2, iterations=4)
            if _misfit(new[:0], nearby) - _misfit(new, nearby) > LEAST_GAIN:
                boxes = np.concatenate([boxes, new])
                surfaces = np.maximum(surfaces, _surfaces(new, view))
            else:
                failures += 1
        if len(boxes):
            boxes = level_boxes(_needed(fit_boxes(boxes, view, blur=1.2, iterations=8), view), view)
    return boxes


def _surfaces(boxes: Array, view: View) -> Array:
    """Return the surface of the boxes with sharp, blurred and wide edges ``(3, N)`` [m]."""
    return np.array([view.surface(boxes, blur=blur) for blur in (0.01, 1.0, 3.0)])


def _explained(surfaces: Array, view: View) -> NDArray[np.bool_]:
    """Return where the surface is what is seen, or where it jumps within a cell ``(N,)``."""
    low, high = surfaces.min(axis=0), surfaces.max(axis=0)
    return (view.heights > low - EXPLAINED) & (view.heights < high + EXPLAINED)


def _misfit(boxes: Array, view: View) -> float:
    """Return the volume between the surface of the boxes and what is seen [m3]."""
    return float(np.abs(view.surface(boxes) - view.heights).sum() * view.cell**2)


def _needed(boxes: Array, view: View) -> Array:
    """Drop, one by one, boxes without which the heightmap is explained as well, or nearly so inside another box."""
    while len(boxes):
        tops = np.vstack([view.ground, view.tops(boxes)])
        surfaces = [np.delete(tops, index, axis=0).max(axis=0) for index in range(1, len(tops))]
        gains = np.abs(np.array(surfaces) - view.heights).sum(axis=1) * view.cell**2 - _misfit(boxes, view)
        gains /= np.where(overlaps(boxes) > MOST_OVERLAP, 10, 1)
        if gains.min() > LEAST_GAIN:
            break
        boxes = np.delete(boxes, int(gains.argmin()), axis=0)
    return boxes


def _as_boxes(scene: Scene, plate: Plate, boxes: Array) -> list[Box]:
    """Return boxes with the material seen on them; one that touches the plate is as thick as it is high."""
    points = _points(scene.grid, scene.materials[0] > 0)
    materials = scene.materials[:, scene.materials[0] > 0]
    low = np.full(len(points), -1.0)
    tops = soft_tops(boxes, points, low, scene.grid.cell)
    highest = tops.argmax(axis=0)
    found: list[Box] = []
    thicknesses = rest_thicknesses(boxes, plate)
    for index, (box, frame, thickness) in enumerate(zip(boxes, axes(boxes), thicknesses, strict=True)):
        length, width = np.maximum(box[6:], 4 * ROUNDING)
        nearest = np.hypot(*(points - box[:2]).T).argmin()
        visible = (highest == index) & (tops[index] > low)
        density, modulus, ratio = np.median(materials[:, visible if visible.any() else [nearest]], axis=1)
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
