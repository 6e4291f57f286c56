"""Figures with 95% intervals by bootstrap: clusters, states or targets, are drawn with replacement, and seeds too."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from pipelines.evaluate.strategies_statistics import PERCENTILES, RESAMPLES

Values = NDArray[np.float64]


@dataclass(frozen=True)
class Estimate:
    """A figure with the ends of its interval."""

    value: float
    low: float
    high: float

    def scaled(self, factor: float) -> "Estimate":
        """Return it in another unit."""
        return Estimate(factor * self.value, factor * self.low, factor * self.high)


class Sample:
    """N samples in clusters that are not independent of each other; one draw of clusters for all figures of them.

    Args:
        groups: Number of each sample's cluster ``(N,)``.
        seeds: Number of trainings that each sample was judged by; figures then take values ``(S, N)``.
    """

    def __init__(self, groups: NDArray[np.integer], *, seeds: int = 1) -> None:
        _, members = np.unique(groups, return_inverse=True)
        clusters = int(members.max()) + 1
        rng = np.random.default_rng(0)
        drawn = rng.multinomial(clusters, np.full(clusters, 1 / clusters), size=RESAMPLES)
        self._weights = drawn[:, members].astype(np.float64)
        self._seeds = rng.multinomial(seeds, np.full(seeds, 1 / seeds), size=RESAMPLES) / seeds

    def mean(self, values: Values) -> Estimate:
        """Return the mean of values ``(N,)`` or ``(S, N)``."""
        return _estimate(float(np.mean(values)), self._means(values))

    def difference(self, values: Values, others: Values) -> Estimate:
        """Return the paired difference of means."""
        return self.mean(values - others)

    def ratio(self, values: Values, others: Values) -> Estimate:
        """Return the ratio of means, of the same samples."""
        drawn = self._means(values) / self._means(others)
        return _estimate(float(np.mean(values) / np.mean(others)), drawn)

    def median(self, values: Values) -> Estimate:
        """Return the median of values ``(N,)``."""
        order = np.argsort(values)
        reached = np.cumsum(self._weights[:, order], axis=1)
        half = reached[:, -1:] / 2
        low, high = (reached >= half).argmax(axis=1), (reached > half).argmax(axis=1)
        drawn = (values[order][low] + values[order][high]) / 2
        return _estimate(float(np.median(values)), drawn)

    def _means(self, values: Values) -> Values:
        """Return the means of all draws ``(R,)``."""
        weights = self._weights / self._weights.sum(axis=1, keepdims=True)
        return np.einsum("rs,sn,rn->r", self._seeds, np.atleast_2d(values), weights, optimize=True)


def _estimate(value: float, drawn: Values) -> Estimate:
    low, high = np.percentile(drawn, PERCENTILES)
    return Estimate(value, float(low), float(high))
