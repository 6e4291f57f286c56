"""How good estimates are: the figures of the paper's Table II, and what decides about accepting a model."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Values = NDArray[np.floating]


@dataclass(frozen=True)
class Acceptance:
    """What accepting a model where its estimate is below ``d_max`` leads to.

    Attributes:
        d_max: The threshold, scaled to [0, 1].
        within: Share of samples whose true deviation is below it.
        auroc: Area under the receiver's characteristic of ``d < d_max``; None if one class is empty.
        false_accept_rate: P(accepted | d >= d_max); None if there is no such sample.
        recall: P(accepted | d < d_max); None if there is no such sample.
        bad_share: P(d >= d_max | accepted); None if nothing was accepted.
        accepted: Share of samples that are accepted.
    """

    d_max: float
    within: float
    auroc: float | None
    false_accept_rate: float | None
    recall: float | None
    bad_share: float | None
    accepted: float


def acceptance(truth: Values, estimates: Values, *, d_max: float) -> Acceptance:
    """Return what accepting by estimates ``(N,)`` leads to, given the true deviations ``(N,)``."""
    good, accepted = truth < d_max, estimates < d_max
    return Acceptance(
        d_max=d_max,
        within=float(good.mean()),
        auroc=auroc(good, -estimates),
        false_accept_rate=_share(accepted[~good]),
        recall=_share(accepted[good]),
        bad_share=_share(~good[accepted]),
        accepted=float(accepted.mean()),
    )


def mean_absolute_error(truth: Values, estimates: Values) -> float:
    """Return the mean of ``|d - m|``."""
    return float(np.abs(truth - estimates).mean())


def coverage(truth: Values, bounds: Values) -> float:
    """Return the share of samples whose true deviation is at most its bound."""
    return float((truth <= bounds).mean())


def auroc(positive: NDArray[np.bool_], scores: Values) -> float | None:
    """Return the probability that a positive sample scores higher than a negative one, ties counted by half."""
    positives, negatives = int(positive.sum()), int((~positive).sum())
    if not positives or not negatives:
        return None
    total = ranks(scores)[positive].sum() - positives * (positives + 1) / 2
    return float(total / (positives * negatives))


def spearman(first: Values, second: Values) -> float | None:
    """Return the rank correlation; None if one side is constant."""
    one, two = ranks(first), ranks(second)
    if np.ptp(one) == 0 or np.ptp(two) == 0:
        return None
    return float(np.corrcoef(one, two)[0, 1])


def ranks(values: Values) -> NDArray[np.float64]:
    """Return the ranks from 1 ``(N,)``; equal values share the mean of theirs."""
    _, place, counts = np.unique(values, return_inverse=True, return_counts=True)
    last = np.cumsum(counts)
    return (last - (counts - 1) / 2)[place]


def _share(values: NDArray[np.bool_]) -> float | None:
    return float(values.mean()) if values.size else None
