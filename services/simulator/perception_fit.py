"""Fit boxes to what is seen: the highest of them and the ground have to be the heightmap."""

from dataclasses import dataclass

import numpy as np

from common.domain.bodies import ROUNDING
from services.simulator.perception_boxes import LENGTH, WIDTH, Array, axes, close_to, soft_tops

STEPS = np.array([2e-4, 2e-4, 2e-4, 5e-3, 5e-3, 5e-3, 3e-4, 3e-4])
"""Steps of the parameters in the finite differences."""
PRIOR_MEAN = np.array([0, 0, 0, 0, 0, 0, LENGTH, WIDTH])
PRIOR_WIDTH = np.array([np.inf, np.inf, np.inf, np.inf, 0.5, 0.15, 0.008, 0.0007])
PRIOR_WEIGHT = 0.5
MARGIN = 0.011
"""How far around a first guess the cells are looked at [m]."""
INSIDE = 0.6
"""Distance from the rounding at which a cell surely shows nothing but the plane of the upper face [cells]."""
FEWEST_CELLS = 10
PLANE_NOISE = 2e-4
"""Noise of such a cell, against which the priors are weighed [m]."""
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

    def tops(self, boxes: Array, *, blur: float = 1.0) -> Array:
        """Return the heights of boxes ``(K, 8)``, ground included ``(K, N)`` [m], edges blurred over ``blur`` cells."""
        tops = np.tile(self.ground, (len(boxes), 1))
        for box, top in zip(boxes, tops, strict=True):
            close = close_to(box, self.points, margin=blur * self.cell)
            top[close] = soft_tops(box, self.points[close], self.ground[close], blur * self.cell)
        return tops

    def surface(self, boxes: Array, *, blur: float = 1.0) -> Array:
        """Return the highest of boxes ``(K, 8)`` and ground ``(N,)`` [m], edges blurred over ``blur`` cells."""
        return np.maximum(self.tops(boxes, blur=blur).max(axis=0, initial=-np.inf), self.ground)

    def near(self, box: Array, *, ground: Array) -> "View":
        """Return the cells around a box ``(8,)``, with another ground ``(N,)`` [m]."""
        close = close_to(box, self.points, margin=MARGIN)
        return View(self.points[close], self.heights[close], ground[close], self.cell)


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
        damped = normal + damping * np.diag(normal.diagonal()) + 1e-9 * np.eye(len(normal))
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


def level_boxes(boxes: Array, view: View) -> Array:
    """Fit the planes of the upper faces to the cells well inside them, which no edge blurs.

    Cells off the plane, hidden by another box, are left out step by step; a box with too few cells stays as it is.
    """
    levelled, margin = boxes.copy(), ROUNDING + INSIDE * view.cell
    for box in levelled:
        inside = close_to(box, view.points, margin=-margin - np.abs(box[4:6]).max() * box[7])
        offset, heights = view.points[inside] - box[:2], view.heights[inside]
        cos, sin = np.cos(box[3]), np.sin(box[3])
        design = np.column_stack([np.ones(len(offset)), offset @ (cos, sin), offset @ (-sin, cos)])
        plane = box[[2, 4, 5]]
        for threshold in (2e-3, 1e-3, 1e-3):
            kept = np.abs(design @ plane - heights) < threshold
            if kept.sum() < FEWEST_CELLS:
                break
            prior = np.diag([0.0, *(PLANE_NOISE / PRIOR_WIDTH[4:6]) ** 2])
            plane = np.linalg.solve(design[kept].T @ design[kept] + prior, design[kept].T @ heights[kept])
        else:
            box[[2, 4, 5]] = plane
    return levelled


def _cost(boxes: Array, view: View, blur: float) -> float:
    size = np.abs(view.surface(boxes, blur=blur) - view.heights) / HUBER
    prior = (boxes - PRIOR_MEAN) / PRIOR_WIDTH
    loss = np.where(size < 1, size**2, 2 * size - 1)
    return float(loss.sum() + PRIOR_WEIGHT * (prior**2).sum())


def _normal_equations(boxes: Array, view: View, blur: float) -> tuple[Array, Array]:
    """Return ``J^T W J`` and ``J^T W r`` in units of `STEPS`, each box changing the cells where it is the highest."""
    tops = view.tops(boxes, blur=blur)
    second, highest = np.sort(np.vstack([view.ground, tops]), axis=0)[-2:]
    others = np.where(tops >= highest, second, highest)
    jacobian = np.zeros((len(boxes), len(STEPS), len(highest)))
    for index, box in enumerate(boxes):
        close = close_to(box, view.points, margin=blur * view.cell)
        moved = soft_tops(box + np.diag(STEPS), view.points[close], view.ground[close], blur * view.cell)
        jacobian[index][:, close] = np.maximum(moved, others[index, close]) - highest[close]
    jacobian = jacobian.reshape(boxes.size, -1) / HUBER
    difference = (highest - view.heights) / HUBER
    weight = 1 / np.maximum(np.abs(difference), 1)
    prior = PRIOR_WEIGHT * (STEPS / PRIOR_WIDTH) ** 2
    normal = (jacobian * weight) @ jacobian.T + np.diag(np.tile(prior, len(boxes)))
    offset = np.where(np.isfinite(PRIOR_WIDTH), (boxes - PRIOR_MEAN) / STEPS, 0.0)
    return normal, jacobian @ (weight * difference) + (prior * offset).ravel()
