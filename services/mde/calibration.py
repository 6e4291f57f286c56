"""Split-conformal calibration: from a raw upper bound to one that holds for a stated share of new states."""

import math

import numpy as np
from numpy.typing import NDArray


def conformal_factor(
    deviations: NDArray[np.floating],
    medians: NDArray[np.floating],
    gaps: NDArray[np.floating],
    *,
    coverage: float,
) -> float:
    """Return the factor c for which ``d <= median + c gap`` holds for a share ``coverage`` of new samples.

    It is the ceil((n + 1) coverage)-th smallest of the n scores ``(d - median) / gap`` (Lei et al. 2018; with the
    gap as the scale, as in conformalised quantile regression, Romano et al. 2019).

    Args:
        deviations: True deviations ``(N,)`` of samples that the network was not trained on.
        medians: Estimated medians ``(N,)``.
        gaps: Distances to the raw upper bound ``(N,)``, above 0.
        coverage: Wanted share, between 0 and 1.
    """
    scores = np.sort((deviations - medians) / gaps)
    rank = math.ceil((len(scores) + 1) * coverage)
    return float(scores[min(rank, len(scores)) - 1])
