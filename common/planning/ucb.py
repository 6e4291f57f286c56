"""GP-UCB: where the upper confidence bound of the reward is highest, in the unit cube of 1 to 6 dimensions."""

import math
from collections.abc import Callable
from functools import cache

import numpy as np
from numpy.typing import NDArray

from common.planning.gp import Float64s

FINEST = 2.5e-4
"""Actions nearer to an asked one than this share of the range are not asked again."""


def quasi_random(count: int, dimensions: int) -> Float64s:
    """Return the first points of the R-sequence ``(count, dimensions)`` in the unit cube (Roberts, 2018)."""
    golden = 2.0
    for _ in range(64):
        golden = (1 + golden) ** (1 / (dimensions + 1))
    steps = golden ** -np.arange(1, dimensions + 1)
    return (0.5 + np.arange(1, count + 1)[:, None] * steps) % 1


@cache
def spread(dimensions: int) -> Float64s:
    """Return candidates all over the unit cube ``(G, n)``: a dense grid up to 2-D, quasi-random points above."""
    if dimensions > 2:
        return quasi_random(4096, dimensions)
    return lattice(1024 if dimensions == 1 else 64, dimensions)


@cache
def offsets(dimensions: int) -> Float64s:
    """Return candidates around 0 within ``[-1, 1]`` ``(M, n)``."""
    if dimensions > 2:
        return 2 * quasi_random(128, dimensions) - 1
    return 2 * lattice(33 if dimensions == 1 else 9, dimensions) - 1


def design(side: int, dimensions: int) -> Float64s:
    """Return points of a regular grid over the unit cube with ``side`` points a side, all of them up to 2-D ``(M, n)``.

    Above, the whole grid would be too many: the lines through its middle along each axis, and quasi-random ones of its
    points, ``(n - 1) side^2`` in all at most. Every coordinate takes ``side`` values, so that what costs time for every
    new value of a parameter costs it ``side`` times.
    """
    if dimensions <= 2:
        return lattice(side, dimensions)
    most = (dimensions - 1) * side**2
    if side**dimensions <= most:
        return lattice(side, dimensions)
    steps = np.linspace(0, 1, side)
    lines = np.full((dimensions, side, dimensions), steps[side // 2])
    for axis in range(dimensions):
        lines[axis, :, axis] = steps
    among = steps[np.minimum((quasi_random(most - dimensions * side, dimensions) * side).astype(int), side - 1)]
    return np.unique(np.concatenate([lines.reshape(-1, dimensions), among]), axis=0)


def neighbourhoods(dimensions: int, finest: float) -> tuple[float, ...]:
    """Return radii that halve from the distance between the candidates of `spread` above 2-D to the finest one."""
    first = 4096 ** (-1 / dimensions)
    return tuple(first / 2**step for step in range(math.ceil(math.log2(first / finest)) + 1))


def lattice(count: int, dimensions: int) -> Float64s:
    """Return a regular grid over the unit cube with ``count`` points a side ``(count^n, n)``."""
    axes = np.meshgrid(*[np.linspace(0, 1, count)] * dimensions, indexing="ij")
    return np.stack(axes, axis=-1).reshape(-1, dimensions)


def maximise(
    bound: Callable[[Float64s], Float64s],
    centres: Float64s,
    heights: Float64s,
    *,
    radii: tuple[float, ...],
    taken: Float64s,
    circular: NDArray[np.bool_] | None = None,
) -> Float64s:
    """Return the point ``(n,)`` where the bound is highest in nested neighbourhoods of several centres.

    Args:
        bound: Upper confidence bound of points ``(M, n)`` -> ``(M,)``.
        centres: Where to begin ``(K, n)``.
        heights: The bound there ``(K,)``, -inf for a centre that must not be returned itself.
        radii: Half the width of each neighbourhood, decreasing.
        taken: Points not to be returned again ``(N, n)``.
        circular: Which coordinates are circles ``(n,)``, None: none.
    """
    steps = offsets(centres.shape[1])
    rows = np.arange(len(centres))
    for radius in radii:
        near = centres[:, None] + radius * steps
        near = np.clip(near, 0, 1) if circular is None else np.where(circular, near % 1, np.clip(near, 0, 1))
        flat = near.reshape(-1, near.shape[-1])
        bounds = np.where(is_free(flat, taken), bound(flat), -np.inf).reshape(near.shape[:2])
        peaks = bounds.argmax(axis=1)
        higher = bounds[rows, peaks] > heights
        centres = np.where(higher[:, None], near[rows, peaks], centres)
        heights = np.maximum(heights, bounds[rows, peaks])
    return centres[int(heights.argmax())]


def is_free(points: Float64s, taken: Float64s) -> NDArray[np.bool_]:
    """Return which points ``(M, n)`` are further than `FINEST` from all of ``taken`` ``(N, n)``."""
    near = np.ones((len(points), len(taken)), dtype=bool)
    for column, taken_column in zip(points.T, taken.T, strict=True):
        near &= np.abs(column[:, None] - taken_column) <= FINEST
    return np.logical_not(np.logical_or.reduce(near, axis=1))
