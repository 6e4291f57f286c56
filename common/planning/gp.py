"""Exact Gaussian process regression, grown point by point, for several length scales at once.

The covariance of two rewards is ``s^2 (k(x, x') + noise [x = x'])`` with the Matern-5/2 correlation ``k``, their mean
an unknown constant. Mean and ``s^2`` follow from the data in closed form, so a length scale fixes the whole model.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Float64s = NDArray[np.float64]

SMALLEST_VARIANCE = 1e-24
"""Keeps a constant reward from making the process certain of everything."""


def matern52(points: Float64s, others: Float64s, scales: Float64s) -> Float64s:
    """Return the correlations ``(1 + d + d^2 / 3) exp(-d)`` with ``d = sqrt(5) |(x - x') / scale|``.

    Args:
        points: ``(M, n)``.
        others: ``(K, n)``.
        scales: A length scale per model and dimension ``(S, n)``.

    Returns:
        ``(S, M, K)``.
    """
    squared = (points[:, None, :] - others[None, :, :]) ** 2
    distance = np.sqrt(5 * np.tensordot(1 / scales**2, squared, axes=(1, 2)))
    return (1 + distance * (1 + distance / 3)) * np.exp(-distance)


@dataclass(frozen=True)
class Fit:
    """What rewards say about each length scale's model.

    Attributes:
        mean: The constant mean ``(S,)``.
        variance: ``s^2`` ``(S,)``.
        residuals: Whitened deviations of the rewards from the mean ``(S, t)``.
        log_likelihood: Log marginal likelihood ``(S,)``.
    """

    mean: Float64s
    variance: Float64s
    residuals: Float64s
    log_likelihood: Float64s


class GaussianProcess:
    """The points of a Gaussian process, factorised for each of S length scales.

    Args:
        scales: Length scales ``(S, n)``.
        noise: Variance of the noise as a share of ``s^2``.
        candidates: Points where predictions are wanted after every change ``(G, n)``; they cost O(S n G) a point.
    """

    def __init__(self, scales: Float64s, *, noise: float, candidates: Float64s) -> None:
        self._scales = scales
        self._noise = noise
        self._candidates = candidates
        self._size = 0
        self._reserve(16)

    @property
    def points(self) -> Float64s:
        """The points so far ``(N, n)``."""
        return self._points[: self._size]

    def truncate(self, size: int) -> None:
        """Forget all points after the first ``size``."""
        if size < self._size:
            self._size = size
            self._explained = (self._whitened[:, :size] ** 2).sum(axis=1)

    def append(self, point: Float64s) -> None:
        """Add a point ``(n,)``, whose reward need not be known."""
        size = self._size
        if size == len(self._points):
            self._reserve(2 * size)
        correlations = matern52(self.points, point[None], self._scales)
        row = (self._inverse[:, :size, :size] @ correlations)[..., 0]
        pivot = np.sqrt(1 + self._noise - (row**2).sum(axis=1))
        correlations = matern52(point[None], self._candidates, self._scales)[:, 0]
        correlations -= np.matmul(row[:, None], self._whitened[:, :size])[:, 0]
        self._whitened[:, size] = correlations / pivot[:, None]
        self._explained += self._whitened[:, size] ** 2
        self._inverse[:, size, :size] = -np.matmul(row[:, None], self._inverse[:, :size, :size])[:, 0] / pivot[:, None]
        self._inverse[:, size, size] = 1 / pivot
        self._points[size] = point
        self._size += 1

    def fit(self, rewards: Float64s, *, mean: float | None = None, variance: float | None = None) -> Fit:
        """Fit mean and ``s^2`` to the rewards ``(t,)`` of the first t points, t at least 1.

        Args:
            rewards: Rewards of the first t points.
            mean: The constant mean; the most likely one if None.
            variance: ``s^2``; the most likely one if None.
        """
        count = len(rewards)
        inverse = self._inverse[:, :count, :count]
        ones, values = inverse.sum(axis=2), inverse @ rewards
        means = (ones * values).sum(axis=1) / (ones**2).sum(axis=1) if mean is None else np.full(len(inverse), mean)
        residuals = values - means[:, None] * ones
        squares = (residuals**2).sum(axis=1)
        likely = squares / count if variance is None else np.full(len(inverse), variance)
        variances = np.maximum(likely, SMALLEST_VARIANCE)
        log_pivots = -np.log(np.diagonal(inverse, axis1=1, axis2=2)).sum(axis=1)
        log_likelihood = -squares / (2 * variances) - log_pivots - count / 2 * np.log(2 * np.pi * variances)
        return Fit(means, variances, residuals, log_likelihood)

    def predict(self, fit: Fit, points: Float64s | None = None, *, scale: int) -> tuple[Float64s, Float64s]:
        """Return mean and standard deviation of the noise-free reward, both ``(M,)``.

        The mean knows the fitted rewards alone; the standard deviation also that the points without one are
        going to be evaluated, which is GP-BUCB's hallucination (Desautels et al., 2014).

        Args:
            fit: From `fit`, for the first t of the points.
            points: ``(M, n)``; the candidates if None.
            scale: Which of the length scales.
        """
        if points is None:
            whitened, explained = self._whitened[scale, : self._size], self._explained[scale]
        else:
            correlations = matern52(self.points, points, self._scales[scale : scale + 1])[0]
            whitened = self._inverse[scale, : self._size, : self._size] @ correlations
            explained = np.einsum("nm,nm->m", whitened, whitened)
        residuals = fit.residuals[scale]
        mean = fit.mean[scale] + residuals @ whitened[: len(residuals)]
        return mean, np.sqrt(fit.variance[scale] * np.maximum(1 - explained, 0))

    def _reserve(self, capacity: int) -> None:
        size, models = self._size, len(self._scales)
        points = np.zeros((capacity, self._scales.shape[1]))
        inverse = np.zeros((models, capacity, capacity))
        whitened = np.zeros((models, capacity, len(self._candidates)))
        if size:
            points[:size] = self._points[:size]
            inverse[:, :size, :size] = self._inverse[:, :size, :size]
            whitened[:, :size] = self._whitened[:, :size]
        else:
            self._explained = np.zeros((models, len(self._candidates)))
        self._points, self._inverse, self._whitened = points, inverse, whitened
