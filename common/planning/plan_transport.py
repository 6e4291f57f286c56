"""Our plan: every simulation tells about its neighbourhood, because its settled surface moves with the item."""

import numpy as np
from numpy.typing import NDArray

from common.domain.certificate import Certificate
from common.domain.errors import RequestError
from common.domain.transport import Transport
from common.planning.certificate import certified_grid, certify, correction, slack
from common.planning.discrepancy import discrepancy
from common.planning.gp import Float64s
from common.planning.places import SPREAD, around, best_apart, find_places, finest
from common.planning.plan import Outcome, Plan, Setting
from common.planning.space import Space, embed

GRIDS = ((8.0, 9), (3.2, 5), (1.0, 7))
"""Nested grids around the best: step in finest distances, points a side."""
CURIOSITY = 1.0
"""Weight of the uncertainty, except in the last call."""
NEAREST = 3
"""Simulations that are fused, besides the best one."""
GAIN = 1e-5
PATIENCE = 9
"""The plan ends after this many calls without a gain of `GAIN` [m]."""
ENOUGH = 5e-5
"""The plan ends when the certificate allows no larger gain [m]."""
FAR_PLACES = 12
PEAKS = 3
"""Simulated actions, apart from each other, whose neighbourhoods are searched."""
ELSEWHERE = (3, 6)
"""After so many calls without a gain the next one goes to a place that no simulation is near."""


class TransportPlan(Plan):
    """Simulate where the cheap models point, then where the transported simulations do.

    Near simulated actions a reward is estimated by transporting the outcomes of the three nearest simulations and of
    the best one, weighted by ``1 / s^2``; at the places of the cheap models that no simulation is near, by the dearest
    of these models and a Gaussian process of what it got wrong so far. The next action has the highest ``mean + s``, in
    the last call the highest mean.

    Args:
        setting: The optimisation.
        calls: Largest number of simulator calls.
        models: How many of the cheap models to ask.
        enough: The plan ends when the certificate allows no larger gain [m].
    """

    def __init__(self, setting: Setting, *, calls: int, models: int, enough: float = ENOUGH) -> None:
        self._setting = setting
        self._calls = min(calls, setting.evaluations)
        self._models = models
        self._enough = enough
        self._unit = finest(setting)
        self._space = Space.of(setting.problem)
        self._range = np.ptp(setting.problem.task.bounds(setting.problem.state), axis=1)
        self._asked: list[Float64s] = []
        self._told: dict[int, tuple[Transport, float]] = {}
        self._uncompared: list[tuple[int, NDArray[np.float32]]] = []
        self._errors: dict[int, float] = {}
        self._deviations: list[tuple[float, float]] = []
        self._idle = 0

    def ask(self) -> Float64s | None:
        """Return the next action ``(n,)``; None if the budget is spent or no call has gained anything lately."""
        if not self._asked:
            self._places = find_places(self._setting, models=self._models)
        if len(self._asked) == self._calls or self._idle >= PATIENCE or self._best_reward >= -GAIN:
            return None
        self._compare()
        if self._told and (certificate := self._certificate()) is not None and certificate.gain <= self._enough:
            return None
        curiosity = 0.0 if len(self._asked) == self._calls - 1 else CURIOSITY
        candidates = [self._best_place(curiosity)]
        if self._told and not (curiosity and self._idle in ELSEWHERE and np.isfinite(candidates[0][0])):
            candidates += self._best_near(curiosity)
        action = max(candidates, key=lambda found: found[0])[1]
        self._asked.append(action)
        return action

    def tell(self, index: int, outcome: Outcome | None) -> None:
        """Learn the outcome of an action.

        Raises:
            RequestError: The task does not say how outcomes move with the action.
        """
        if outcome is None:
            return
        problem, action = self._setting.problem, self._asked[index]
        transport = problem.task.transport(problem.state, action, outcome.heights)
        if transport is None:
            raise RequestError(f"strategy transport: expected a task with a transport, got {problem.task.name}")
        self._idle = 0 if outcome.reward > self._best_reward + GAIN else self._idle + 1
        self._told[index] = transport, outcome.reward
        self._uncompared.append((index, outcome.heights))

    def certificate(self) -> Certificate | None:
        """Return how much better another action may be; None before the first outcome or without an MDE's bound."""
        if not self._told or self._places.estimates is None:
            return None
        self._compare()
        return self._certificate()

    def slack(self) -> tuple[float, float] | None:
        """Return what the MDE's bounds leave possible [m] and the share of the places that may be better."""
        found, places = self._places.estimates, self._places
        if found is None or found.scale_m is None or not found.familiar.any():
            return None
        typical = float(found.mean.mean()) * found.scale_m
        factor = correction(self._deviations, typical) * found.scale_m
        return slack(places, factor * found.upper, self._best_reward)

    @property
    def model(self) -> str:
        """The cheap model whose places are searched; empty without one."""
        return self._places.model

    def grid(self) -> Float64s:
        """Return the actions that the certificate is about ``(G, n)``."""
        best = max(self._told, key=lambda index: self._told[index][1])
        return certified_grid(self._places, self._asked[best], self._unit, self._space)

    def _certificate(self) -> Certificate | None:
        found = self.slack()
        if found is None:
            return None
        return certify(self._places.model, *found, calls=len(self._told), actions=len(self.grid()))

    @property
    def _best_reward(self) -> float:
        return max((reward for _, reward in self._told.values()), default=-np.inf)

    def _best_place(self, curiosity: float) -> tuple[float, Float64s]:
        """Return the best of the cheap models' places, and its score."""
        places = self._places
        mean, deviation = self._corrected()
        if self._told:
            asked = np.stack(self._asked)
            gaps = (
                ((self._space.gaps(places.actions[:, None], asked) / (SPREAD * self._unit)) ** 2)
                .sum(axis=2)
                .min(axis=1)
            )
            new = np.flatnonzero(gaps >= 1)
            if not len(new):
                return -np.inf, places.actions[0]
            bound = (mean + curiosity * deviation)[new]
            apart = new[best_apart(places.actions[new], bound, FAR_PLACES, SPREAD / 2 * self._unit, self._space)]
            actions = places.actions[apart]
            mean, deviation = mean[apart], deviation[apart]
        else:
            actions = places.actions
        scores = self._scores(actions, mean, deviation, curiosity)
        return float(scores.max()), actions[int(scores.argmax())]

    def _best_near(self, curiosity: float) -> list[tuple[float, Float64s]]:
        """Return the best action in nested grids around each of the best simulated ones, with its score."""
        actions = np.stack([self._asked[index] for index in self._told])
        rewards = np.array([reward for _, reward in self._told.values()])
        peaks = best_apart(actions, rewards, PEAKS, SPREAD * self._unit, self._space)
        return [self._climb(actions[peak], curiosity) for peak in peaks]

    def _climb(self, centre: Float64s, curiosity: float) -> tuple[float, Float64s]:
        """Return the best action in nested grids around a simulated one, and its score."""
        score = -np.inf
        for step, side in GRIDS:
            actions = around(centre[None], step * self._unit, side=side, space=self._space)
            scores = self._scores(actions, *self._fuse(actions), curiosity)
            if scores.max() > score or not np.isfinite(score):
                score, centre = float(scores.max()), actions[int(scores.argmax())]
        return score, centre

    def _fuse(self, actions: Float64s) -> tuple[Float64s, Float64s]:
        """Return mean and standard deviation of the rewards of actions ``(B, n)``."""
        weighted, weights = np.zeros(len(actions)), np.zeros(len(actions))
        for index in self._around(self._space.middle(actions)):
            transport = self._told[index][0]
            weight = 1 / transport.errors(actions) ** 2
            weighted += weight * transport.rewards(actions, self._setting.problem.target)
            weights += weight
        return weighted / weights, 1 / np.sqrt(weights)

    def _around(self, middle: Float64s) -> set[int]:
        """Return the simulations that are nearest to an action, and the best one."""
        distance = {i: float(((self._space.gaps(self._asked[i], middle) / self._unit) ** 2).sum()) for i in self._told}
        near = sorted(self._told, key=distance.__getitem__)
        return {*near[:NEAREST], max(self._told, key=lambda index: self._told[index][1])}

    def _scores(self, actions: Float64s, mean: Float64s, deviation: Float64s, curiosity: float) -> Float64s:
        """Return ``mean + curiosity deviation``, lowered near pending actions and impossible at asked ones."""
        scores = mean + curiosity * deviation
        for index, asked in enumerate(self._asked):
            distance = np.sqrt(((self._space.gaps(actions, asked) / self._unit) ** 2).sum(axis=1))
            if index not in self._told:
                scores = scores - deviation * np.exp(-distance / FAR_PLACES)
            scores = np.where(distance < 0.4, -np.inf, scores)
        return scores

    def _compare(self) -> None:
        """Ask the cheap model and its MDE about what was simulated since; without a model its rewards are 0."""
        if not self._uncompared:
            return
        indices = [index for index, _ in self._uncompared]
        actions = np.stack([self._asked[index] for index in indices])
        model, survey = self._places.model, self._setting.survey
        cheap = np.zeros(len(actions)), np.zeros(len(actions))
        if model:
            cheap = survey.compare(model, actions, np.stack([heights for _, heights in self._uncompared]))
        self._uncompared.clear()
        if cheap is None:
            return
        rewards = np.array([self._told[index][1] for index in indices])
        self._errors.update(zip(indices, (rewards - cheap[0]).tolist(), strict=True))
        found = None if self._places.estimates is None else survey.estimates(model, actions)
        if found is not None and found.scale_m is not None:
            self._deviations += zip((found.scale_m * found.mean).tolist(), cheap[1].tolist(), strict=True)

    def _corrected(self) -> tuple[Float64s, Float64s]:
        """Return mean and standard deviation of the rewards at the places, corrected by what calls have shown [m]."""
        places, scale = self._places, self._range
        known = [index for index in self._told if index in self._errors]
        found, deviation = discrepancy(
            self._share(np.array([self._asked[index] for index in known]).reshape(-1, len(scale))),
            np.array([self._errors[index] for index in known]),
            [self._share(asked) for index, asked in enumerate(self._asked) if index not in self._errors],
            self._share(places.actions),
        )
        return places.rewards + found, deviation * places.widths

    def _share(self, actions: Float64s) -> Float64s:
        """Return actions ``(..., n)`` as shares of the range, circles laid out in the plane."""
        return embed(actions / self._range, self._space.circular)
