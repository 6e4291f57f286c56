"""Where to begin: the places that the cheap models find best, each model asked only where the cheaper ones point."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from common.domain.deviation import Estimates
from common.planning.discrepancy import discrepancy
from common.planning.gp import Float64s
from common.planning.plan import Setting
from common.planning.space import Space, embed
from common.planning.ucb import design

FINEST_SHARE = 1 / 640
"""The distance at which outcomes begin to differ, as a share of the task's range: 0.25 mm in plating."""
COARSE, FINE = 40, 10
"""Steps of the sweep and of the search around its best places, in finest distances."""
COARSER = (40, 20)
"""Above two parameters the sweep leaves larger gaps: steps of the searches before that, in finest distances."""
SEARCHED = 4
"""Best places of the sweep around which it is refined."""
FIRST, ROUNDS, PICKED = 8, 4, 3
"""Of how many places a dearer model is asked first, how often again where that points, and of how many each time."""
HASTY = 6, 1, 2
"""The same where time is short."""
SIDE_MOST = 41
SPREAD = 3 * COARSE // 4
"""Least distance between two of the best places, in finest distances."""
MOST_PLACES = 64


@dataclass(frozen=True)
class Swept:
    """Everything that the sweeps found out.

    Attributes:
        model: The cheapest model that answered; empty if none did, and then its rewards are 0.
        actions: What it was asked about ``(G, n)``.
        rewards: Its rewards ``(G,)`` [m].
        known: What the dearest one was asked about besides ``(K, n)``.
        differences: Its rewards there minus the cheapest model's ``(K,)`` [m].
    """

    model: str
    actions: Float64s
    rewards: Float64s
    known: Float64s
    differences: Float64s


@dataclass(frozen=True)
class Places:
    """Actions with what the dearest cheap model that answered says about them.

    Attributes:
        actions: ``(P, n)``.
        rewards: Predicted rewards ``(P,)`` [m].
        widths: Relative uncertainty by the MDE, 1 on average ``(P,)``.
        estimates: What the MDE says; None without one.
        model: The model; empty if none answered, and then all rewards are 0.
        swept: What lies behind them.
    """

    actions: Float64s
    rewards: Float64s
    widths: Float64s
    estimates: Estimates | None
    model: str
    swept: Swept


def finest(setting: Setting) -> Float64s:
    """Return the distance at which outcomes begin to differ, by action parameter ``(n,)``."""
    problem = setting.problem
    return np.ptp(problem.task.bounds(problem.state), axis=1) * FINEST_SHARE


def find_places(setting: Setting, *, models: int, hasty: bool = False) -> Places:
    """Sweep the cheapest model over the bounds, and ask the next ones about some of its best places.

    Args:
        setting: The optimisation.
        models: How many of the cheap models to ask.
        hasty: Whether the dearer ones are asked less often.
    """
    unit, space = finest(setting), Space.of(setting.problem)
    swept, model = _sweep(setting, unit, space)
    known, cheapest = swept, model
    for name in setting.cheap[1:models] if model else setting.cheap[1:]:
        better = _look_closer(setting, name, known, unit, space, HASTY if hasty else (FIRST, ROUNDS, PICKED))
        if better is not None:
            known, model = better, name
    chosen = best_apart(*known, MOST_PLACES if model else len(known[0]), FINE / 2 * unit, space)
    actions = known[0][chosen]
    found = setting.survey.estimates(model, actions) if model else None
    background = _background(setting, cheapest, swept, known if model != cheapest else None)
    return Places(actions, known[1][chosen], _relative(found, len(actions)), found, model, background)


def _background(
    setting: Setting, cheapest: str, swept: tuple[Float64s, Float64s], known: tuple[Float64s, Float64s] | None
) -> Swept:
    _, first = np.unique(swept[0], axis=0, return_index=True)
    actions, rewards = swept[0][np.sort(first)], swept[1][np.sort(first)]
    if known is not None:
        cheap = setting.survey.rewards(cheapest, known[0]) if cheapest else np.zeros(len(known[0]))
        if cheap is not None:
            return Swept(cheapest, actions, rewards, known[0], known[1] - cheap)
    return Swept(cheapest, actions, rewards, np.zeros((0, actions.shape[1])), np.zeros(0))


def best_apart(actions: Float64s, rewards: Float64s, count: int, distance: Float64s, space: Space) -> NDArray[np.intp]:
    """Return the indices of the best actions that are further than ``distance`` ``(n,)`` from each other."""
    chosen: list[int] = []
    for index in np.argsort(-rewards, kind="stable"):
        gaps = np.abs(space.gaps(actions[chosen], actions[index])) / distance
        if not len(chosen) or ((gaps**2).sum(axis=1) >= 1).all():
            chosen.append(int(index))
        if len(chosen) == count:
            break
    return np.array(chosen, dtype=np.intp)


def around(centres: Float64s, steps: Float64s, *, side: int, space: Space) -> Float64s:
    """Return a grid of ``side`` points a side about each centre ``(K, n)``, above 2-D a part of it, see `design`."""
    dimensions = centres.shape[1]
    offsets = (side - 1) * (design(side, dimensions) - 0.5) * steps
    near = (centres[:, None] + offsets).reshape(-1, dimensions)
    return np.unique(space.confine(near), axis=0)


def _sweep(setting: Setting, unit: Float64s, space: Space) -> tuple[tuple[Float64s, Float64s], str]:
    limits = space.limits
    side = int(np.clip(np.ceil(np.ptp(limits, axis=1) / (COARSE * unit)).max() + 1, 2, SIDE_MOST))
    actions = limits[:, 0] + design(side, len(limits)) * np.ptp(limits, axis=1)
    if space.circular.any():
        actions = np.unique(space.confine(actions), axis=0)
    for model in setting.cheap[:1]:
        rewards = setting.survey.rewards(model, actions)
        if rewards is None:
            continue
        searches = [*((step, 3) for step in COARSER if len(limits) > 2), (FINE, 5)]
        for step, points in searches:
            best = best_apart(actions, rewards, SEARCHED, SPREAD * unit, space)
            near = around(actions[best], step * unit, side=points, space=space)
            finer = setting.survey.rewards(model, near)
            if finer is not None:
                actions, rewards = np.concatenate([actions, near]), np.concatenate([rewards, finer])
        return (actions, rewards), model
    middle = np.argsort((((actions - limits.mean(axis=1)) / unit) ** 2).sum(axis=1), kind="stable")
    return (actions[middle], np.zeros(len(actions))), ""


def _look_closer(
    setting: Setting,
    model: str,
    known: tuple[Float64s, Float64s],
    unit: Float64s,
    space: Space,
    effort: tuple[int, int, int],
) -> tuple[Float64s, Float64s] | None:
    """Return what a dearer model says about some of the best places, and where that points."""
    first, rounds, picked_most = effort
    spans = np.ptp(space.limits, axis=1)
    shares = embed(known[0] / spans, space.circular)
    chosen = best_apart(*known, first, SPREAD / 2 * unit, space)
    rewards = setting.survey.rewards(model, known[0][chosen])
    if rewards is None:
        return None
    for _ in range(rounds):
        found, deviation = discrepancy(shares[chosen], rewards - known[1][chosen], [], shares)
        bounds = known[1] + found + deviation
        gaps = space.gaps(known[0][:, None], known[0][chosen]) / (FINE / 2 * unit)
        bounds[((gaps**2).sum(axis=2) < 1).any(axis=1)] = -np.inf
        picked = best_apart(known[0], bounds, picked_most, FINE * unit, space)
        picked = picked[np.isfinite(bounds[picked])]
        more = setting.survey.rewards(model, known[0][picked]) if len(picked) else None
        if more is None:
            break
        chosen, rewards = np.concatenate([chosen, picked]), np.concatenate([rewards, more])
    return known[0][chosen], rewards


def relative_widths(setting: Setting, model: str, actions: Float64s) -> Float64s:
    """Return the uncertainty of a model's rewards by its MDE, 1 on average ``(B,)``; 1 everywhere without an MDE."""
    return _relative(setting.survey.estimates(model, actions) if model else None, len(actions))


def _relative(found: Estimates | None, count: int) -> Float64s:
    if found is None or found.mean.mean() <= 0:
        return np.ones(count)
    return np.maximum(found.mean / found.mean.mean(), 0.1)
