"""How much better than the best simulated action another one may be: bounds by the MDE, and what became of them.

Reward and deviation share one norm, so ``r_cheap(a) + u(a)`` bounds the simulated reward of an action wherever the
deviation is at most u(a). The *slack*, ``max_a r_cheap(a) + rho u(a) - r_best`` over the cheap model's best places, is
what these bounds leave possible after k simulations. An MDE's bound holds action by action and for nine states in ten,
not for all actions of a state at once, and it is far from tight, so the slack is no statement with a probability.
The certificate ``factor slack / k`` is one: the factor is the conformal quantile, over development targets, of the
largest ``k gain_k / slack_k`` of a whole optimisation. For another target from the same source the gain is at most
that with the stated probability, whatever the errors of model and MDE, and after any number of simulations, so that an
optimisation may stop by it.
"""

import math
from collections.abc import Mapping, Sequence

import numpy as np

from common.domain.certificate import Certificate
from common.planning.gp import Float64s
from common.planning.places import Places, around
from common.planning.space import Space

PROBABILITY = 0.9
FACTORS: Mapping[str, float] = {"heuristic": 2.7, "learned": 1.1}
"""Factor by the model whose places are searched; `frugal evaluate certificate` measures it."""
RING_STEP, RING_SIDE = 4.0, 7
"""The grid around the answer: step in finest distances, points a side."""
SMALLEST = 1e-5
"""Slack below which rewards are as good as equal [m]."""


def correction(compared: Sequence[tuple[float, float]], typical: float) -> float:
    """Return by which factor a model deviates more in this state than its MDE says, ``(sum d_k + m) / (sum m_k + m)``.

    Args:
        compared: Estimated and true deviation ``(m_k, d_k)`` of each simulated action [m].
        typical: Estimated deviation m on average [m]; it counts as one more that was as expected.
    """
    estimated, found = (sum(pair[side] for pair in compared) + typical for side in (0, 1))
    return found / estimated if estimated > 0 else 1.0


def slack(places: Places, uppers: Float64s, best: float) -> tuple[float, float]:
    """Return what bounds leave possible [m], and the share of the places that may be better than the best reward.

    Args:
        places: Where the cheap model was asked.
        uppers: Bounds of its deviation there ``(P,)`` [m].
        best: The best simulated reward [m].
    """
    bounds = places.rewards + uppers
    return float(bounds.max()) - best, float((bounds > best).mean())


def needed_factor(gain: float, possible: float, calls: int) -> float:
    """Return the smallest factor for which a certificate after some calls would have held.

    Args:
        gain: How much better than the answer the best action of the grid was [m].
        possible: The slack [m].
        calls: Number of simulations.
    """
    return max(gain, 0.0) * calls / max(possible, SMALLEST)


def conformal_quantile(scores: Sequence[float], probability: float = PROBABILITY) -> float:
    """Return the ceil((n + 1) p)-th smallest of n scores; infinity where there are too few for such a statement."""
    rank = math.ceil((len(scores) + 1) * probability)
    return float(np.sort(scores)[rank - 1]) if rank <= len(scores) else math.inf


def certify(model: str, possible: float, left: float, *, calls: int, actions: int) -> Certificate | None:
    """Return the certificate after some simulations; None if there is no factor for places of this model.

    Args:
        model: The model whose places were searched.
        possible: The slack [m].
        left: Share of the places that may be better.
        calls: Number of simulations, 1 at least.
        actions: Number of actions on the grid.
    """
    if model not in FACTORS:
        return None
    return Certificate(FACTORS[model] * max(possible, SMALLEST) / calls, PROBABILITY, actions, left)


def certified_grid(places: Places, answer: Float64s, unit: Float64s, space: Space) -> Float64s:
    """Return the actions that a certificate is about ``(G, n)``: the places and a grid around the answer ``(n,)``.

    Args:
        places: The cheap model's best places.
        answer: The best simulated action.
        unit: The finest distances ``(n,)``.
        space: The bounds of the action parameters.
    """
    ring = around(answer[None], RING_STEP * unit, side=RING_SIDE, space=space)
    return np.unique(np.concatenate([places.actions, ring]), axis=0)
