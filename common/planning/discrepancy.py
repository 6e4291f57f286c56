"""How far a cheap model's rewards are from the trusted one's, everywhere, from where both are known."""

from collections.abc import Sequence
from math import sqrt

import numpy as np

from common.planning.gp import Float64s, GaussianProcess

LENGTH = 0.1
"""Length scale as a share of the range in 2-D; it grows as distances in the unit cube do with its dimension."""
NOISE = 1e-3
"""Variance of the noise as a share of the discrepancy's."""
WIDTH = 4e-4
"""Standard deviation of a cheap model's rewards before any was compared with the trusted one's [m]."""


def discrepancy(
    known: Float64s, differences: Float64s, pending: Sequence[Float64s], actions: Float64s
) -> tuple[Float64s, Float64s]:
    """Return mean and standard deviation [m] of the discrepancy at actions ``(B, n)``, by a Gaussian process.

    `WIDTH` counts as one more known difference where the process's variance is estimated.

    Args:
        known: Actions where it is known, as shares of the range ``(t, n)``.
        differences: Trusted minus cheap reward there ``(t,)`` [m].
        pending: Actions where it is going to be known, as shares of the range, each ``(n,)``.
        actions: Where it is wanted, as shares of the range ``(B, n)``.
    """
    count, dimensions = len(known), actions.shape[1]
    if not count:
        return np.zeros(len(actions)), np.full(len(actions), WIDTH)
    length = LENGTH * sqrt(max(dimensions, 2) / 2)
    process = GaussianProcess(np.full((1, dimensions), length), noise=NOISE, candidates=np.zeros((0, dimensions)))
    for action in (*known, *pending):
        process.append(action)
    variance = (WIDTH**2 + ((differences - differences.mean()) ** 2).sum()) / count
    return process.predict(process.fit(differences, variance=variance), actions, scale=0)
