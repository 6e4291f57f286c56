"""Trials that together look like what the robot will meet: kernel herding (Chen, Welling and Smola 2010).

A last layer that is fine-tuned on chosen trials minimises its error on these. Trials that are chosen where least is
known are the extreme ones, and the error elsewhere grows again; trials that look like everything together do not have
this fault.
"""

import math
from collections.abc import Sequence

import numpy as np

from common.domain.errors import RequestError
from pipelines.mde.active_belief import Values, matern, squared_distances

REACH = 2.0
"""Length scale of the Matern-5/2 kernel, over the median distance of what will be met [-]."""


def choose_representative(met: Values, tried: Values, candidates: Values, *, count: int = 1) -> list[int]:
    """Return the candidates to try next, in this order, no two the same.

    Each is where ``mean_r k(x, r) - sum_t k(x, t) / (T + 1)`` is largest, r what will be met and t the T trials so far:
    near to much that will be met, far from what was tried.

    Args:
        met: Descriptions of what will be met ``(R, D)``.
        tried: Those of the trials so far ``(T, D)``, none or more.
        candidates: Those of what may be tried ``(C, D)``.
        count: How many to choose, at most C.

    Raises:
        RequestError: There are not so many candidates.
    """
    if count > len(candidates):
        raise RequestError(f"count: expected 1 to {len(candidates)}, the number of candidates, got {count}")
    apart = squared_distances(met, met)[~np.eye(len(met), dtype=bool)]
    scale = max(REACH * math.sqrt(float(np.median(apart))), 1e-12) if len(apart) else 1.0
    towards = matern(candidates, met, scale).mean(axis=1)
    away, among = matern(candidates, tried, scale).sum(axis=1), matern(candidates, candidates, scale)
    chosen: list[int] = []
    for number in range(count):
        scores = towards - away / (len(tried) + number + 1)
        scores[chosen] = -math.inf
        chosen.append(int(scores.argmax()))
        away = away + among[:, chosen[-1]]
    return chosen


def order_of(described: Values, first: Sequence[int], count: int) -> list[int]:
    """Return ``first`` and the points that are chosen after them out of all of them, ``count`` in all."""
    left = [index for index in range(len(described)) if index not in first]
    picked = choose_representative(described, described[list(first)], described[left], count=count - len(first))
    return [*first, *(left[index] for index in picked)]
