"""Boxes as they look from above: soft-edged heights for fitting, and the fit itself.

A row of parameters is ``(x, y, z, yaw, pitch, roll, length, width)``: the centre of the upper face [m], the direction
of the long axis [rad], the slopes of the long and the short axis [-], and the edges [m]; the section is square.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

LENGTH, WIDTH = 0.060, 0.010
"""Edges that a fry is expected to have [m]."""
STEPS = np.array([2e-4, 2e-4, 2e-4, 5e-3, 5e-3, 5e-3, 3e-4, 3e-4])
"""Steps of the parameters in the finite differences."""
PRIOR_MEAN = np.array([0, 0, 0, 0, 0, 0, LENGTH, WIDTH])
PRIOR_WIDTH = np.array([np.inf, np.inf, np.inf, np.inf, 0.5, 0.15, 0.008, 0.0007])
PRIOR_WEIGHT = 0.5
HUBER = 5e-3
"""Differences above this count linearly [m]: point samples beside an edge are off by the whole edge."""


@dataclass(frozen=True)
class View:
    """Cells of a heightmap that boxes have to explain.

    Attributes:
        points: Centres of the cells ``(N, 2)`` [m].
        heights: What is seen there ``(N,)`` [m].
        ground: What is there besides the boxes ``(N,)`` [m].
        cell: Edge of a cell [m].
    """

    points: Array
    heights: Array
    ground: Array
    cell: float

    def surface(self, boxes: Array, *, blur: float = 1.0) -> Array:
        """Return the highest of boxes ``(K, 8)`` and ground ``(N,)`` [m], edges blurred over ``blur`` cells."""
        return soft_tops(boxes, self.points, self.ground, blur * self.cell).max(axis=0, initial=-1.0).clip(self.ground)

    def near(self, box: Array, *, ground: Array) -> "View":
        """Return the cells around a box ``(8,)``, with another ground ``(N,)`` [m]."""
        close = np.hypot(*(self.points - box[:2]).T) < 0.75 * box[6]
        return View(self.points[close], self.heights[close], ground[close], self.cell)


def axes(boxes: Array) -> Array:
    """Return the unit axes of boxes ``(..., 8)`` as rows ``(..., 3, 3)``: along, across, up."""
    cos, sin, pitch, roll = np.cos(boxes[..., 3]), np.sin(boxes[..., 3]), boxes[..., 4], boxes[..., 5]
    stretch = 1 / np.sqrt(1 + pitch**2)
    lean = 1 / np.sqrt(1 + roll**2 / (1 + pitch**2))
    shear = -roll * pitch * stretch**2  # what makes (-sin, cos, roll) orthogonal to (cos, sin, pitch)
    along = (cos * stretch, sin * stretch, pitch * stretch)
    across = ((shear * cos - sin) * lean, (shear * sin + cos) * lean, (shear * pitch + roll) * lean)
    up = tuple(along[i - 2] * across[i - 1] - along[i - 1] * across[i - 2] for i in range(3))
    return np.stack([*along, *across, *up], axis=-1).reshape(*boxes.shape[:-1], 3, 3)


def soft_tops(boxes: Array, points: Array, ground: Array, blur: float) -> Array:
    """Return the heights of boxes over points, their outline blurred into the ground over ``blur``.

    The upper face continues down the side faces that can be seen from above.

    Args:
        boxes: ``(..., 8)``.
        points: ``(N, 2)`` [m].
        ground: Height of what is below each point ``(N,)`` [m].
        blur: Width of the ramp that stands for the edge, the grid's cell [m].

    Returns:
        Heights ``(..., N)`` [m].
    """
    frame = axes(boxes)
    flat = frame[..., :2, :2]  # rows: along and across seen from above
    determinant = flat[..., 0, 0] * flat[..., 1, 1] - flat[..., 0, 1] * flat[..., 1, 0]
    offset = points - boxes[..., None, :2]
    top = np.broadcast_to(boxes[..., 2, None], offset.shape[:-1]).copy()
    cover = np.ones_like(top)
    drop = np.zeros_like(top)
    down = -frame[..., 2, :2]
    for axis, sign in ((0, 1.0), (1, -1.0)):
        other = flat[..., 1 - axis, :]
        coordinate = sign * _cross(offset, other[..., None, :]) / determinant[..., None]
        side = boxes[..., 7] * sign * _cross(down, other) / determinant  # how far the lower face is displaced
        half = boxes[..., 6 + axis] / 2
        stretch = np.linalg.norm(flat[..., axis, :], axis=-1)[..., None]
        low, high = -half + np.minimum(side, 0), half + np.maximum(side, 0)
        inside = np.minimum(coordinate - low[..., None], high[..., None] - coordinate) * stretch
        cover *= np.clip(0.5 + inside / blur, 0, 1)
        top += np.clip(coordinate, -half[..., None], half[..., None]) * frame[..., axis, 2, None]
        beyond = (coordinate * np.sign(side)[..., None] - half[..., None]) / np.maximum(np.abs(side), 1e-5)[..., None]
        drop = np.maximum(drop, np.clip(beyond, 0, 1))
    top -= drop * (boxes[..., 7] * frame[..., 2, 2])[..., None]
    return ground + np.maximum(top - ground, 0) * cover


def fit_boxes(boxes: Array, view: View, *, blur: float, iterations: int) -> Array:
    """Improve boxes ``(K, 8)`` so that the highest of them and the ground matches what is seen.

    Levenberg and Marquardt on a Huber loss with priors on size, pitch and roll.

    Args:
        boxes: First guess ``(K, 8)``.
        view: What is seen.
        blur: Width of the edges in cells: wide ones find their place from further away, narrow ones more exactly.
        iterations: Largest number of steps.
    """
    damping = 1e-2
    best, cost = boxes, _cost(boxes, view, blur)
    normal, gradient = _normal_equations(best, view, blur)
    for _ in range(iterations):
        damped = normal + damping * np.diag(np.diag(normal)) + 1e-9 * np.eye(len(normal))
        step = np.linalg.solve(damped, gradient).reshape(best.shape) * STEPS
        trial = best - np.clip(step, -20 * STEPS, 20 * STEPS)
        trial[:, 6:] = np.maximum(trial[:, 6:], (0.02, 0.005))
        trial[:, 4:6] = np.clip(trial[:, 4:6], -1.5, 1.5)
        trial_cost = _cost(trial, view, blur)
        if trial_cost >= cost:
            damping *= 8
            continue
        gain, best, cost, damping = cost - trial_cost, trial, trial_cost, max(damping / 4, 1e-4)
        if gain < 1e-3 * cost:
            break
        normal, gradient = _normal_equations(best, view, blur)
    return best


def stretch_box(box: Array, view: View) -> Array:
    """Move the two ends of a box ``(1, 8)`` by up to 9 mm to where they match best what is seen."""
    moves = np.arange(-3, 4) * 0.003
    ends = np.stack(np.meshgrid(moves, moves), axis=-1).reshape(-1, 2)
    candidates = np.repeat(box, len(ends), axis=0)
    candidates[:, 6] += ends.sum(axis=1)
    candidates[:, :3] += (ends[:, 1:] - ends[:, :1]) / 2 * axes(box)[:, 0]
    candidates = candidates[candidates[:, 6] > LENGTH / 2]
    tops = np.maximum(soft_tops(candidates, view.points, view.ground, view.cell), view.ground)
    misfits = np.abs(tops - view.heights).sum(axis=1)
    return candidates[[int(misfits.argmin())]]


def _cost(boxes: Array, view: View, blur: float) -> float:
    size = np.abs(view.surface(boxes, blur=blur) - view.heights) / HUBER
    prior = (boxes - PRIOR_MEAN) / PRIOR_WIDTH
    loss = np.where(size < 1, size**2, 2 * size - 1)
    return float(loss.sum() + PRIOR_WEIGHT * (prior**2).sum())


def _normal_equations(boxes: Array, view: View, blur: float) -> tuple[Array, Array]:
    """Return ``J^T W J`` and ``J^T W r`` in units of `STEPS`, each box changing the cells where it is the highest."""
    tops = soft_tops(boxes, view.points, view.ground, blur * view.cell)
    ranked = np.sort(np.concatenate([tops, view.ground[None], np.full((1, len(view.ground)), -1.0)]), axis=0)
    highest, second = ranked[-1], ranked[-2]
    moved = soft_tops(boxes[:, None, :] + np.diag(STEPS), view.points, view.ground, blur * view.cell)  # (K, 8, N)
    others = np.where(tops >= highest, second, highest)
    jacobian = (np.maximum(moved, others[:, None]) - highest).reshape(boxes.size, -1) / HUBER
    difference = (highest - view.heights) / HUBER
    weight = 1 / np.maximum(np.abs(difference), 1)
    prior = PRIOR_WEIGHT * (STEPS / PRIOR_WIDTH) ** 2
    normal = (jacobian * weight) @ jacobian.T + np.diag(np.tile(prior, len(boxes)))
    offset = np.where(np.isfinite(PRIOR_WIDTH), (boxes - PRIOR_MEAN) / STEPS, 0.0)
    return normal, jacobian @ (weight * difference) + (prior * offset).ravel()


def overlaps(boxes: Array) -> Array:
    """Return the largest share of each box's volume that lies inside one other box ``(K,)``."""
    frame = axes(boxes)
    half = boxes[:, [6, 7, 7]] / 2
    centre = boxes[:, :3] - frame[:, 2] * half[:, 2:]
    lattice = np.stack(np.meshgrid(np.linspace(-0.9, 0.9, 13), *2 * [[-0.67, 0.0, 0.67]]), axis=-1).reshape(-1, 3)
    points = centre[:, None] + (lattice * half[:, None]) @ frame
    local = np.einsum("ipjc,jac->ipja", points[:, :, None] - centre, frame)  # point p of box i in the frame of box j
    shares = (np.abs(local) < half).all(axis=-1).mean(axis=1)
    np.fill_diagonal(shares, 0)
    return shares.max(axis=1)


def _cross(first: Array, second: Array) -> Array:
    return first[..., 0] * second[..., 1] - first[..., 1] * second[..., 0]
