"""What trials say about a model's deviation elsewhere: a Gaussian process on the frozen descriptions of an MDE.

The residual ``d - m`` of the MDE's estimate m has the covariance ``s^2 (1 + u u' + k(|u - u'|) + noise [same trial])``:
a shift, a linear function of the description u, which is what a last layer can learn, and a Matern-5/2 process for what
is not linear. ``u`` holds the white descriptions of all members, ``|u|^2`` about 1 on the training data.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import product

import numpy as np
from numpy.typing import NDArray

Values = NDArray[np.float64]

SCALES, NOISES = (0.5, 1.0, 2.0), (0.1, 0.3, 1.0)
"""Length scales in u, and variances of the noise as shares of s^2; the most likely pair is taken."""

SPREAD, PRIOR_TRIALS = 0.1, 3
"""Before any trial s is this, on the scale of [0, 1], as if so many trials had shown it."""


@dataclass(frozen=True)
class Points:
    """States with actions as the networks of an MDE see them.

    Attributes:
        described: u of each ``(M, D)``.
        estimates: What the MDE says about each ``(M,)``, scaled to [0, 1].
    """

    described: Values
    estimates: Values

    def part(self, chosen: Sequence[int]) -> "Points":
        """Return some of them, by their numbers."""
        return Points(self.described[list(chosen)], self.estimates[list(chosen)])


@dataclass(frozen=True)
class Belief:
    """A Gaussian over the true deviations, without their noise, at points of which the first may be tried next.

    Attributes:
        mean: ``(M,)``.
        covariance: ``(M, M)``.
        noise: Variance of what one trial shows beside it.
        candidates: Number of the points that may be tried.
    """

    mean: Values
    covariance: Values
    noise: float
    candidates: int

    @property
    def variance(self) -> Values:
        """``(M,)``."""
        return np.diagonal(self.covariance).clip(0)

    def reductions(self) -> Values:
        """Return by how much each candidate would lower the mean variance of the points behind the candidates ``(C,)``.

        Of all points where there are none behind.
        """
        met = slice(self.candidates if self.candidates < len(self.mean) else 0, None)
        rows = self.covariance[: self.candidates]
        return (rows[:, met] ** 2).mean(axis=1) / (self.variance[: self.candidates] + self.noise)

    def tried(self, index: int) -> "Belief":
        """Return the belief once a candidate has been tried and has shown what was expected."""
        row = self.covariance[index]
        covariance = self.covariance - np.outer(row, row) / (row[index] + self.noise)
        return Belief(self.mean, covariance, self.noise, self.candidates)


def believe(known: Points, deviations: Values, points: Points, *, candidates: int) -> Belief:
    """Return what trials say about points.

    Args:
        known: The trials, none or more.
        deviations: Their true deviations ``(N,)``, scaled to [0, 1].
        points: The points, those that may be tried first.
        candidates: Number of these.
    """
    residuals = deviations - known.estimates
    fits = [_fit(known, residuals, *pair) for pair in product(SCALES, NOISES)]
    _, variance, scale, noise = max(fits, key=lambda fit: fit[0])
    prior = _kernel(points.described, points.described, scale)
    if not len(deviations):
        return Belief(points.estimates, variance * prior, variance * noise, candidates)
    lower = _factor(known, scale, noise)
    whitened = np.linalg.solve(lower, _kernel(known.described, points.described, scale))
    mean = points.estimates + whitened.T @ np.linalg.solve(lower, residuals)
    return Belief(mean, variance * (prior - whitened.T @ whitened), variance * noise, candidates)


def _fit(known: Points, residuals: Values, scale: float, noise: float) -> tuple[float, float, float, float]:
    """Return log likelihood and s^2 of a length scale and a noise, and these."""
    count = len(residuals)
    lower = _factor(known, scale, noise)
    squares = float((np.linalg.solve(lower, residuals) ** 2).sum()) if count else 0.0
    variance = (PRIOR_TRIALS * SPREAD**2 + squares) / (PRIOR_TRIALS + count)
    likelihood = -float(np.log(np.diagonal(lower)).sum()) - (PRIOR_TRIALS + count) / 2 * math.log(variance)
    return likelihood, variance, scale, noise


def _factor(known: Points, scale: float, noise: float) -> Values:
    count = len(known.estimates)
    covariance = _kernel(known.described, known.described, scale) + noise * np.eye(count)
    return np.asarray(np.linalg.cholesky(covariance), dtype=np.float64)


def _kernel(points: Values, others: Values, scale: float) -> Values:
    return np.asarray(1 + points @ others.T + matern(points, others, scale), dtype=np.float64)


def matern(points: Values, others: Values, scale: float) -> Values:
    """Return the Matern-5/2 correlation of points ``(N, D)`` and others ``(M, D)``: ``(N, M)``."""
    distance = math.sqrt(5) / scale * np.sqrt(squared_distances(points, others))
    return np.asarray((1 + distance * (1 + distance / 3)) * np.exp(-distance), dtype=np.float64)


def squared_distances(points: Values, others: Values) -> Values:
    """Return ``|p - o|^2`` of points ``(N, D)`` and others ``(M, D)``: ``(N, M)``."""
    found = (points**2).sum(axis=1)[:, None] + (others**2).sum(axis=1) - 2 * points @ others.T
    return np.asarray(found.clip(0), dtype=np.float64)
