"""Figures with 95% intervals, by resampling targets; differences and ratios are paired."""

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

Values = NDArray[np.float64]
Statistic = Callable[[Values], Values]
Figure = dict[str, float | None]

RESAMPLES = 2000
PERCENTILES = (2.5, 97.5)


def mean(values: Values) -> Values:
    """Return the mean over the last axis."""
    return np.mean(values, axis=-1)


def median(values: Values) -> Values:
    """Return the median over the last axis."""
    return np.median(values, axis=-1)


def figure(statistic: Statistic, values: Values) -> Figure:
    """Return ``value``, ``low`` and ``high`` of a statistic of values ``(T,)``, NaN where a target has none."""
    known = values[~np.isnan(values)]
    if not len(known):
        return {"value": None, "low": None, "high": None}
    low, high = np.percentile(statistic(known[_draws(len(known))]), PERCENTILES)
    return {"value": float(statistic(known)), "low": float(low), "high": float(high)}


def compared(statistic: Statistic, values: Values, others: Values) -> Figure:
    """Return ``difference`` and ``ratio`` to others ``(T,)``, each with ``_low`` and ``_high``; None where undefined.

    Targets that have both values count.
    """
    known = ~np.isnan(values) & ~np.isnan(others)
    names = [f"{name}{end}" for name in ("difference", "ratio") for end in ("", "_low", "_high")]
    if not known.any():
        return dict.fromkeys(names)
    values, others = values[known], others[known]
    draws = _draws(len(values))
    own, other = statistic(values[draws]), statistic(others[draws])
    found = [float(statistic(values) - statistic(others)), *np.percentile(own - other, PERCENTILES).tolist()]
    if (other > 0).all() and statistic(others) > 0:
        found += [float(statistic(values) / statistic(others)), *np.percentile(own / other, PERCENTILES).tolist()]
    return dict(zip(names, [*found, *[None] * (len(names) - len(found))], strict=True))


def _draws(count: int) -> NDArray[np.int64]:
    return np.random.default_rng(0).integers(count, size=(RESAMPLES, count))
