"""Our plan: every simulation tells about its neighbourhood, because its settled surface moves with the item."""

import numpy as np

from common.domain.errors import RequestError
from common.domain.transport import Transport
from common.planning.gp import Float64s
from common.planning.places import SPREAD, around, best_apart, find_places, finest
from common.planning.plan import Outcome, Plan, Setting

GRIDS = ((8.0, 9), (3.2, 5), (1.0, 7))
"""Nested grids around the best: step in finest distances, points a side."""
CURIOSITY = 1.0
"""Weight of the uncertainty, except in the last call."""
NEAREST = 3
"""Simulations that are fused, besides the best one."""
GAIN = 1e-5
PATIENCE = 5
"""The plan ends after this many calls without a gain of `GAIN` [m]."""
FAR_PLACES = 12
WIDTH = 4e-4
"""Standard deviation of a cheap model's rewards before any was compared with the trusted one [m]."""


class TransportPlan(Plan):
    """Simulate where the cheap models point, then where the transported simulations do.

    The reward of an action is estimated by transporting the outcomes of the three nearest simulations and of the best
    one, weighted by ``1 / s^2``, and at the places of the cheap models by those too. The next action has the highest
    ``mean + s``, in the last call the highest mean.

    Args:
        setting: The optimisation.
        calls: Largest number of simulator calls.
        models: How many of the cheap models to ask.
    """

    def __init__(self, setting: Setting, *, calls: int, models: int) -> None:
        self._setting = setting
        self._calls = min(calls, setting.evaluations)
        self._models = models
        self._unit = finest(setting)
        self._asked: list[Float64s] = []
        self._told: dict[int, tuple[Transport, float]] = {}
        self._failed: set[int] = set()
        self._uncompared: list[int] = []
        self._errors: list[float] = []
        self._idle = 0

    def ask(self) -> Float64s | None:
        """Return the next action ``(n,)``; None if the budget is spent or no call has gained anything lately."""
        if not self._asked:
            self._places = find_places(self._setting, models=self._models)
        if len(self._asked) == self._calls or self._idle >= PATIENCE or self._best_reward >= -GAIN:
            return None
        self._compare()
        curiosity = 0.0 if len(self._asked) == self._calls - 1 else CURIOSITY
        candidates = [self._best_place(curiosity)]
        if self._told:
            candidates.append(self._best_near(curiosity))
        action = max(candidates, key=lambda found: found[0])[1]
        self._asked.append(action)
        return action

    def tell(self, index: int, outcome: Outcome | None) -> None:
        """Learn the outcome of an action.

        Raises:
            RequestError: The task does not say how outcomes move with the action.
        """
        if outcome is None:
            self._failed.add(index)
            return
        problem, action = self._setting.problem, self._asked[index]
        transport = problem.task.transport(problem.state, action, outcome.heights)
        if transport is None:
            raise RequestError(f"strategy transport: expected a task with a transport, got {problem.task.name}")
        self._idle = 0 if outcome.reward > self._best_reward + GAIN else self._idle + 1
        self._told[index] = transport, outcome.reward
        self._uncompared.append(index)

    @property
    def _best_reward(self) -> float:
        return max((reward for _, reward in self._told.values()), default=-np.inf)

    def _best_place(self, curiosity: float) -> tuple[float, Float64s]:
        """Return the best of the cheap models' places, and its score."""
        places = self._places
        bias, width = self._correction()
        mean, deviation = places.rewards + bias, width * places.widths
        if self._told:
            apart = best_apart(places.actions, mean + curiosity * deviation, FAR_PLACES, SPREAD / 2 * self._unit)
            actions = places.actions[apart]
            mean, deviation = self._fuse(actions, prior=(mean[apart], deviation[apart]))
        else:
            actions = places.actions
        scores = self._scores(actions, mean, deviation, curiosity)
        return float(scores.max()), actions[int(scores.argmax())]

    def _best_near(self, curiosity: float) -> tuple[float, Float64s]:
        """Return the best action in nested grids around the best simulated one, and its score."""
        centre = self._asked[max(self._told, key=lambda index: self._told[index][1])]
        score = -np.inf
        for step, side in GRIDS:
            actions = around(centre[None], step * self._unit, side=side, limits=self._setting.problem.limits)
            scores = self._scores(actions, *self._fuse(actions), curiosity)
            if scores.max() > score or not np.isfinite(score):
                score, centre = float(scores.max()), actions[int(scores.argmax())]
        return score, centre

    def _fuse(self, actions: Float64s, prior: tuple[Float64s, Float64s] | None = None) -> tuple[Float64s, Float64s]:
        """Return mean and standard deviation of the rewards of actions ``(B, n)``."""
        weighted, weights = np.zeros(len(actions)), np.zeros(len(actions))
        if prior is not None:
            weights += 1 / prior[1] ** 2
            weighted += weights * prior[0]
        for index in self._told if prior is not None else self._around(actions.mean(axis=0)):
            transport = self._told[index][0]
            weight = 1 / transport.errors(actions) ** 2
            weighted += weight * transport.rewards(actions, self._setting.problem.target)
            weights += weight
        return weighted / weights, 1 / np.sqrt(weights)

    def _around(self, middle: Float64s) -> set[int]:
        """Return the simulations that are nearest to an action, and the best one."""
        near = sorted(self._told, key=lambda index: float((((self._asked[index] - middle) / self._unit) ** 2).sum()))
        return {*near[:NEAREST], max(self._told, key=lambda index: self._told[index][1])}

    def _scores(self, actions: Float64s, mean: Float64s, deviation: Float64s, curiosity: float) -> Float64s:
        """Return ``mean + curiosity deviation``, lowered near pending actions and impossible at asked ones."""
        scores = mean + curiosity * deviation
        for index, asked in enumerate(self._asked):
            distance = np.sqrt((((actions - asked) / self._unit) ** 2).sum(axis=1))
            if index not in self._told:
                scores = scores - deviation * np.exp(-distance / FAR_PLACES)
            scores = np.where(distance < 0.4, -np.inf, scores)
        return scores

    def _compare(self) -> None:
        """Ask the cheap model about what was simulated since the last time."""
        if self._places.model and self._uncompared:
            actions = np.stack([self._asked[index] for index in self._uncompared])
            cheap = self._setting.survey.rewards(self._places.model, actions)
            if cheap is not None:
                rewards = np.array([self._told[index][1] for index in self._uncompared])
                self._errors += (rewards - cheap).tolist()
        self._uncompared.clear()

    def _correction(self) -> tuple[float, float]:
        """Return the cheap model's bias and the standard deviation of what is left [m], from what calls have shown."""
        count, errors = len(self._errors), np.array(self._errors)
        bias = float(errors.sum()) / (count + 1)
        return bias, float(np.sqrt((WIDTH**2 + ((errors - bias) ** 2).sum()) / (count + 1)))
