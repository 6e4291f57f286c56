"""What fine-tuning gives: networks, what they say about trials that they did not see, the bound that rests on that."""

import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from services.mde.calibration import conformal_factor
from services.mde.distance import mahalanobis
from services.mde.ensemble import Ensemble

Values = NDArray[np.float64]

FEW = 20
"""With fewer judged trials the bound is at least as wide as the base's."""

ROUNDING = 1e-3
"""By this share a limit is wider than the distance it stands for: members computed together round differently."""


@dataclass(frozen=True)
class Finetuned:
    """A fine-tuned ensemble.

    Attributes:
        ensemble: The networks, with means, whitenings and limits; `facts` are for the card to set.
        judged: Trials that some networks did not see ``(M,)``, indices.
        median: Mean of those networks' medians for each ``(M,)``.
        gap: Mean of their distances to the raw upper bound ``(M,)``.
        chosen: What cross-validation decided, for the card.
    """

    ensemble: Ensemble
    judged: NDArray[np.int64]
    median: Values
    gap: Values
    chosen: Mapping[str, Any] = field(default_factory=dict[str, Any])


@dataclass(frozen=True)
class Bound:
    """The upper bound ``median + factor gap``.

    Attributes:
        factor: Its factor.
        coverage: Share of the judged trials that lie below a bound which the other ones give.
        rests_on: What the factor is, in a few words.
    """

    factor: float
    coverage: float
    rests_on: str


def calibrate(
    deviations: NDArray[np.floating], median: Values, gap: Values, *, coverage: float, least: float | None
) -> Bound:
    """Return the bound for estimates of networks that did not see the trials.

    Every trial counts: those of one part are judged by networks that saw the other parts (cross-conformal, Vovk 2015),
    while a split would leave too few for the quantile. With fewer than `FEW` trials it is at least the base's; where
    they are too few for a quantile of this coverage, it also holds for all of them.

    Args:
        deviations: True deviations ``(M,)``.
        median: Estimated medians ``(M,)``.
        gap: Distances to the raw upper bound ``(M,)``.
        coverage: Wanted share, between 0 and 1.
        least: Factor of the base; None if there is none.
    """
    count = len(deviations)
    factor, rests_on = conformal_factor(deviations, median, gap, coverage=coverage), f"quantile of {count} trials"
    if math.ceil((count + 1) * coverage) > count:
        rests_on = f"largest of {count} trials"
    if least is not None and count < FEW and factor < least:
        factor, rests_on = least, f"that of the base: {count} trials ask for less"
    floor = -math.inf if least is None or count >= FEW else least
    others = ~np.eye(count, dtype=bool)
    covered = [
        deviations[index]
        <= median[index]
        + max(floor, conformal_factor(deviations[rest], median[rest], gap[rest], coverage=coverage)) * gap[index]
        for index, rest in enumerate(others)
    ]
    return Bound(factor, float(np.mean(covered)), rests_on)


def limits_for(ensemble: Ensemble, descriptions: Tensor, *, familiar: float, least: Tensor | None) -> Tensor:
    """Return the largest familiar distance of each member ``(K,)``: the trials are familiar, and what was stays so.

    Args:
        ensemble: The networks with means and whitenings.
        descriptions: Of the trials ``(K, S, N, F)``.
        familiar: Share of the trials within the limit; of few trials all are.
        least: Limits of the base ``(K,)``; None if there is none.
    """
    found = torch.stack(
        [
            torch.quantile(
                mahalanobis(part.flatten(0, 1), ensemble.means[index], ensemble.whitenings[index]),
                familiar,
                interpolation="higher",
            )
            for index, part in enumerate(descriptions)
        ]
    )
    found = found * (1 + ROUNDING)
    return found if least is None else torch.maximum(found, least)
