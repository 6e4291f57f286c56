"""Boxes as they look from above: soft-edged heights for fitting, and the fit itself.

A row of parameters is ``(x, y, z, yaw, pitch, roll, length, width)``: the centre of the upper face [m], the direction
of the long axis [rad], the slopes of the long and the short axis [-], and the edges [m]; the section is square.
"""

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

LENGTH, WIDTH = 0.060, 0.010
"""Edges that a fry is expected to have [m]."""
STEPS = np.array([2e-4, 2e-4, 2e-4, 5e-3, 5e-3, 5e-3, 3e-4, 3e-4])
"""Steps of the parameters in the finite differences."""
PRIOR_MEAN = np.array([0, 0, 0, 0, 0, 0, LENGTH, WIDTH])
PRIOR_WIDTH = np.array([np.inf, np.inf, np.inf, np.inf, 0.5, 0.15, 0.008, 0.0007])
PRIOR_WEIGHT = 3.0
HUBER = 1e-3
"""Differences above this count linearly [m]: point samples beside an edge are off by the whole edge."""


def axes(boxes: Array) -> Array:
    """Return the unit axes of boxes ``(..., 8)`` as rows ``(..., 3, 3)``: along, across, up."""
    yaw, pitch, roll = boxes[..., 3], boxes[..., 4], boxes[..., 5]
    along = np.stack([np.cos(yaw), np.sin(yaw), pitch], axis=-1)
    along /= np.linalg.norm(along, axis=-1, keepdims=True)
    across = np.stack([-np.sin(yaw), np.cos(yaw), roll], axis=-1)
    across -= (across * along).sum(axis=-1, keepdims=True) * along
    across /= np.linalg.norm(across, axis=-1, keepdims=True)
    return np.stack([along, across, np.cross(along, across)], axis=-2)


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


def fit_boxes(boxes: Array, points: Array, heights: Array, ground: Array, blur: float, *, iterations: int) -> Array:
    """Improve boxes ``(K, 8)`` so that the highest of them and the ground matches the heights.

    Levenberg and Marquardt on a Huber loss with priors on size, pitch and roll.

    Args:
        boxes: First guess ``(K, 8)``.
        points: Cells to be explained ``(N, 2)`` [m].
        heights: What was seen there ``(N,)`` [m].
        ground: What is there besides these boxes ``(N,)`` [m].
        blur: See `soft_tops`.
        iterations: Largest number of steps.
    """
    damping = 1e-2
    best, cost = boxes, _cost(boxes, points, heights, ground, blur)
    normal, gradient = _normal_equations(best, points, heights, ground, blur)
    for _ in range(iterations):
        damped = normal + damping * np.diag(np.diag(normal)) + 1e-9 * np.eye(len(normal))
        step = np.linalg.solve(damped, gradient).reshape(best.shape) * STEPS
        trial = best - np.clip(step, -20 * STEPS, 20 * STEPS)
        trial[:, 6:] = np.maximum(trial[:, 6:], (0.02, 0.005))
        trial[:, 4:6] = np.clip(trial[:, 4:6], -1.5, 1.5)
        trial_cost = _cost(trial, points, heights, ground, blur)
        if trial_cost >= cost:
            damping *= 8
            continue
        gain, best, cost, damping = cost - trial_cost, trial, trial_cost, max(damping / 4, 1e-4)
        if gain < 1e-3 * cost:
            break
        normal, gradient = _normal_equations(best, points, heights, ground, blur)
    return best


def _cost(boxes: Array, points: Array, heights: Array, ground: Array, blur: float) -> float:
    model = np.maximum(soft_tops(boxes, points, ground, blur).max(axis=0), ground)
    size = np.abs(model - heights) / HUBER
    prior = (boxes - PRIOR_MEAN) / PRIOR_WIDTH
    loss = np.where(size < 1, size**2, 2 * size - 1)
    return float(loss.sum() + PRIOR_WEIGHT * (prior**2).sum())


def _normal_equations(
    boxes: Array, points: Array, heights: Array, ground: Array, blur: float
) -> tuple[Array, Array]:
    """Return ``J^T W J`` and ``J^T W r`` in units of `STEPS`, box by box where each is the highest."""
    count = len(boxes)
    tops = soft_tops(boxes, points, ground, blur)
    ranked = np.sort(np.concatenate([tops, ground[None], np.full((1, len(ground)), -np.inf)]), axis=0)
    highest, second = ranked[-1], ranked[-2]
    moved = soft_tops(boxes[:, None, :] + np.diag(STEPS), points, ground, blur)  # (K, 8, N)
    others = np.where(tops >= highest, second, highest)
    jacobian = (np.maximum(moved, others[:, None]) - highest).reshape(8 * count, -1) / HUBER
    difference = (highest - heights) / HUBER
    weight = 1 / np.maximum(np.abs(difference), 1)
    prior = PRIOR_WEIGHT * (STEPS / PRIOR_WIDTH) ** 2
    normal = (jacobian * weight) @ jacobian.T + np.diag(np.tile(prior, count))
    offset = np.where(np.isfinite(PRIOR_WIDTH), (boxes - PRIOR_MEAN) / STEPS, 0.0)
    return normal, jacobian @ (weight * difference) + (prior * offset).ravel()


def _cross(first: Array, second: Array) -> Array:
    return first[..., 0] * second[..., 1] - first[..., 1] * second[..., 0]
