"""How far a cheap model's rewards are from better ones, everywhere, from where both are known."""

from collections.abc import Sequence
from math import sqrt
from typing import cast

import numpy as np

from common.planning.gp import Float64s, matern52

LENGTH = 0.1
"""Length scale as a share of the range in 2-D; it grows as distances in the unit cube do with its dimension."""
NOISE = 3e-6
"""Standard deviation of a difference that is known well [m]."""
WIDTH = 4e-4
"""Standard deviation of a cheap model's rewards before any was compared with a better one's [m]."""


def discrepancy(
    known: Float64s,
    differences: Float64s,
    pending: Sequence[Float64s],
    actions: Float64s,
    *,
    noises: Float64s | float = NOISE,
) -> tuple[Float64s, Float64s]:
    """Return mean and standard deviation [m] of the discrepancy at actions ``(B, n)``, by a Gaussian process.

    `WIDTH` counts as one more known difference where the process's variance is estimated; its mean is unknown.

    Args:
        known: Actions where it is known, as shares of the range ``(t, n)``.
        differences: Better minus cheap reward there ``(t,)`` [m].
        pending: Actions where it is going to be known, as shares of the range, each ``(n,)``.
        actions: Where it is wanted, as shares of the range ``(B, n)``.
        noises: How well it is known, one standard deviation ``(t,)`` or the same for all [m].
    """
    count, dimensions = len(known), actions.shape[1]
    if not count:
        return np.zeros(len(actions)), np.full(len(actions), WIDTH)
    scales = np.full((1, dimensions), LENGTH * sqrt(max(dimensions, 2) / 2))
    variance = (WIDTH**2 + ((differences - differences.mean()) ** 2).sum()) / count
    points = np.concatenate([known, *(point[None] for point in pending)])
    noise = np.full(len(points), NOISE)
    noise[:count] = noises
    covariances = variance * matern52(points, points, scales)[0] + np.diag(noise**2)
    towards = variance * matern52(actions, points, scales)[0]
    wanted = np.stack([differences, np.ones(count)], axis=1)
    weights = cast(Float64s, np.linalg.solve(covariances[:count, :count], wanted))
    mean = weights[:, 0].sum() / weights[:, 1].sum()
    found = mean + towards[:, :count] @ (weights[:, 0] - mean * weights[:, 1])
    solved = cast(Float64s, np.linalg.solve(covariances, towards.T))
    explained = (solved * towards.T).sum(axis=0)
    return found, np.sqrt(np.maximum(variance - explained, 0))
