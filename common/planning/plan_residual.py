"""A plan: GP-UCB on what the cheap models do not explain."""

import math

import numpy as np

from common.planning.discrepancy import discrepancy
from common.planning.gp import Float64s
from common.planning.places import around, best_apart, find_places, finest, relative_widths
from common.planning.plan import Outcome, Plan, Setting
from common.planning.space import Space, embed

BETA = 4.0
DOZEN = 12
"""Candidates about which all cheap models are asked."""
UNKNOWN = 0.4
"""Scaled deviation of a model without an MDE."""
GRIDS = ((8.0, 9), (3.2, 5), (1.0, 7))
"""Grids around the best simulated action: step in finest distances, points a side."""
GAIN, PATIENCE = 1e-5, 5
"""The plan ends after so many calls without such a gain [m], above two parameters n times as many.

A call tells about one direction from the best action, and there are more of them.
"""


class ResidualPlan(Plan):
    """Sweep the cheap models for a prior mean of the reward and spend the trusted model's calls on the residual.

    The prior mean is that of the cheapest model; at the dozen candidates with the highest bounds the others are asked
    too, and all are fused, weighted by ``1 / MDE^2``. The residual is a Gaussian process whose width the MDE scales;
    pending actions are hallucinated as in GP-BUCB.

    Args:
        setting: The optimisation.
        calls: Largest number of calls of the trusted model.
    """

    def __init__(self, setting: Setting, *, calls: int) -> None:
        self._setting = setting
        self._calls = min(calls, setting.evaluations)
        self._unit = finest(setting)
        self._space = Space.of(setting.problem)
        self._patience = PATIENCE * (len(self._unit) if len(self._unit) > 2 else 1)
        self._range = np.ptp(setting.problem.task.bounds(setting.problem.state), axis=1)
        self._asked: list[Float64s] = []
        self._priors: list[float] = []
        self._rewards: dict[int, float] = {}
        self._idle = 0

    def ask(self) -> Float64s | None:
        """Return the next action ``(n,)``; None if the budget is spent or no call has gained anything lately."""
        if not self._asked:
            self._places = find_places(self._setting, models=1)
        if len(self._asked) == self._calls or self._idle >= self._patience or self._best_reward >= -GAIN:
            return None
        curiosity = 0.0 if len(self._asked) == self._calls - 1 else math.sqrt(BETA)
        actions, prior, widths = self._candidates()
        mean, deviation = self._residual(actions)
        bound = self._free(actions, prior + mean + curiosity * widths * deviation)
        few = best_apart(actions, bound, DOZEN, self._unit, self._space)
        fused = self._fused(actions[few], prior[few])
        chosen = int(self._free(actions[few], bound[few] + fused - prior[few]).argmax())
        self._asked.append(actions[few[chosen]])
        self._priors.append(float(fused[chosen]))
        return self._asked[-1]

    def tell(self, index: int, outcome: Outcome | None) -> None:
        """Learn the reward of an action."""
        if outcome is not None:
            self._idle = 0 if outcome.reward > self._best_reward + GAIN else self._idle + 1
            self._rewards[index] = outcome.reward

    @property
    def _best_reward(self) -> float:
        return max(self._rewards.values(), default=-np.inf)

    def _candidates(self) -> tuple[Float64s, Float64s, Float64s]:
        """Return actions, the cheapest model's rewards and the relative widths by its MDE."""
        places = self._places
        if not self._rewards:
            return places.actions, places.rewards, places.widths
        centre = self._asked[max(self._rewards, key=self._rewards.__getitem__)][None]
        space = self._space
        near = np.concatenate([around(centre, step * self._unit, side=side, space=space) for step, side in GRIDS])
        rewards = self._setting.survey.rewards(places.model, near) if places.model else np.zeros(len(near))
        if rewards is None:
            return places.actions, places.rewards, places.widths
        actions = np.concatenate([places.actions, near])
        widths = relative_widths(self._setting, places.model, actions)
        return actions, np.concatenate([places.rewards, rewards]), widths

    def _residual(self, actions: Float64s) -> tuple[Float64s, Float64s]:
        """Return mean and standard deviation [m] of the residual at actions ``(B, n)``."""
        told = [index for index in range(len(self._asked)) if index in self._rewards]
        known = np.array([self._asked[index] for index in told]).reshape(-1, len(self._range))
        pending = [self._share(asked) for index, asked in enumerate(self._asked) if index not in self._rewards]
        residuals = np.array([self._rewards[index] - self._priors[index] for index in told])
        return discrepancy(self._share(known), residuals, pending, self._share(actions))

    def _share(self, actions: Float64s) -> Float64s:
        return embed(actions / self._range, self._space.circular)

    def _fused(self, actions: Float64s, rewards: Float64s) -> Float64s:
        """Return the rewards by all cheap models, weighted by ``1 / MDE^2``."""
        weights = self._precision(self._places.model, actions)
        weighted = weights * rewards
        for model in self._setting.cheap[1:]:
            found = self._setting.survey.rewards(model, actions)
            if found is not None:
                weight = self._precision(model, actions)
                weighted += weight * found
                weights = weights + weight
        return weighted / weights

    def _precision(self, model: str, actions: Float64s) -> Float64s:
        found = self._setting.survey.estimates(model, actions) if model else None
        return 1 / (np.full(len(actions), UNKNOWN) if found is None else np.maximum(found.mean, 0.02)) ** 2

    def _free(self, actions: Float64s, bound: Float64s) -> Float64s:
        """Return the bound, impossible at asked actions."""
        for asked in self._asked:
            near = ((self._space.gaps(actions, asked) / self._unit) ** 2).sum(axis=1) < 0.4**2
            bound = np.where(near, -np.inf, bound)
        return bound
