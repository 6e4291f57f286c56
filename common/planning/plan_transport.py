"""Our plan: every simulation tells about its neighbourhood, because its settled surface moves with the item."""

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from common.domain.certificate import Certificate
from common.domain.deviation import deviation
from common.domain.errors import RequestError
from common.planning.blend import Blend
from common.planning.certificate import certified_grid, certify, correction, slack
from common.planning.discrepancy import NOISE, WIDTH, discrepancy
from common.planning.gp import Float64s
from common.planning.places import SPREAD, Places, around, find_places, finest
from common.planning.plan import Outcome, Plan, Setting
from common.planning.space import Space, embed

GRIDS = ((8.0, 5), (3.2, 5), (1.0, 5))
"""Nested grids around the best: step in finest distances, points a side."""
CURIOSITY = 0.5
"""Weight of the uncertainty, except in the last call."""
NEAR = 8e-3
"""Beyond this distance from all simulations nothing is blended [m]."""
CHEAP_NOISE = 8e-5
"""How far off the rewards of the dearest cheap model are by themselves, one standard deviation [m]."""
GAIN = 1e-5
REACHED, PATIENCE, PATIENCE_REACHED = -5e-4, 6, 4
"""The plan ends after so many calls without a gain of `GAIN`, fewer where a reward above `REACHED` [m] was found."""
ENOUGH = 5e-5
"""The plan ends when the certificate allows no larger gain [m]."""
CONFIRMED, CONFIRMING = 2.5e-4, 6
"""Deviation [m] up to which the trusted model confirms a rehearsal, and by what its number of calls is divided then."""
PENDING = 12.0
"""Distance from a pending action at which it matters little, in finest distances."""


class TransportPlan(Plan):
    """Simulate where the cheap models point, then where the transported simulations do.

    Near simulated actions a reward is estimated by a `Blend` of the transported outcomes; everywhere by the cheapest
    model and a Gaussian process of what it gets wrong, as the dearest cheap model and the simulations show. At swept
    actions near a simulation both are fused, weighted by ``1 / s^2``. The next action has the highest
    ``mean + s / 2``, in the last call the highest mean.

    Args:
        setting: The optimisation.
        calls: Largest number of simulator calls.
        hasty: Whether the cheap models but the cheapest are asked less often.
        enough: The plan ends when the certificate allows no larger gain [m].
    """

    def __init__(self, setting: Setting, *, calls: int, hasty: bool = False, enough: float = ENOUGH) -> None:
        self._setting = setting
        self._calls = min(calls, setting.evaluations)
        self._hasty = hasty
        self._enough = enough
        self._unit = finest(setting)
        self._space = Space.of(setting.problem)
        self._range = np.ptp(setting.problem.task.bounds(setting.problem.state), axis=1)
        self._blend = Blend(setting.problem.target)
        self._rehearsed: dict[bytes, NDArray[np.float32]] = {}
        self._asked: list[Float64s] = []
        self._rewards: dict[int, float] = {}
        self._errors: dict[int, float] = {}
        self._uncompared: list[tuple[int, NDArray[np.float32]]] = []
        self._compared: list[Float64s] = []
        self._deviations: list[tuple[float, float]] = []
        self._idle = 0

    def ask(self) -> Float64s | None:
        """Return the next action ``(n,)``; None if the budget is spent or no call has gained anything lately."""
        if not self._asked:
            self._places = self._begin()
        if len(self._asked) >= self._calls or self._idle >= self._patience or self._best_reward >= -GAIN:
            return None
        self._compare()
        if self._rewards and (certificate := self._certificate()) is not None and certificate.gain <= self._enough:
            return None
        curiosity = 0.0 if len(self._asked) >= self._calls - 1 else CURIOSITY
        candidates = [self._best_anywhere(curiosity)]
        if self._rewards:
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
            return
        problem, action = self._setting.problem, self._asked[index]
        transport = problem.task.transport(problem.state, action, outcome.heights)
        if transport is None:
            raise RequestError(f"strategy transport: expected a task with a transport, got {problem.task.name}")
        if self._rehearsed:
            self._judge(action, outcome)
        if len(self._blend) and self._blend.nearest(action[None])[0] < NEAR:
            self._blend.compare(action, outcome.reward)
        self._blend.add(action, transport)
        self._idle = 0 if outcome.reward > self._best_reward + GAIN else self._idle + 1
        self._rewards[index] = outcome.reward
        self._uncompared.append((index, outcome.heights))

    def certificate(self) -> Certificate | None:
        """Return how much better another action may be; None before the first outcome or without an MDE's bound."""
        if not self._rewards or self._places.estimates is None:
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
        best = max(self._rewards, key=self._rewards.__getitem__)
        return certified_grid(self._places, self._asked[best], self._unit, self._space)

    def _begin(self) -> Places:
        """Return where to begin: what the sweeps found, or what a level of the trusted model was asked about.

        The level is optimised as if it were the trusted one.
        """
        setting, level = self._setting, self._setting.level
        if level is None:
            return find_places(setting, models=len(setting.cheap), hasty=self._hasty)
        names = *(name for name in setting.cheap if name != level), level
        inner = TransportPlan(
            replace(setting, models=names, trusted=level, evaluations=self._calls), calls=self._calls, hasty=self._hasty
        )
        rehearsed: dict[bytes, NDArray[np.float32]] = {}
        while (action := inner.ask()) is not None:
            found = setting.survey.outcomes(level, action[None])
            if found is None:
                return replace(inner._places, estimates=None)
            reward = float(setting.problem.task.reward(found[0], setting.problem.target))
            inner.tell(len(rehearsed), Outcome(level, reward, found[0]))
            rehearsed[action.tobytes()] = found[0]
        inner._compare()
        self._blend, self._rehearsed, self._swept = inner._blend, rehearsed, inner._places.swept
        actions, rewards = np.stack(inner._asked), np.array([*inner._rewards.values()])
        swept = replace(
            self._swept,
            known=np.concatenate([self._swept.known, actions[list(inner._errors)]]),
            differences=np.concatenate([self._swept.differences, [*inner._errors.values()]]),
        )
        return Places(actions, rewards, np.ones(len(actions)), None, level, swept)

    def _judge(self, action: Float64s, outcome: Outcome) -> None:
        """Make few more calls where the trusted model's first outcome confirms the rehearsal, else forget it."""
        known = self._rehearsed.get(action.tobytes())
        if known is not None and deviation(outcome.heights, known) <= CONFIRMED:
            self._calls = max(self._calls // CONFIRMING, 1)
        else:
            self._blend = Blend(self._setting.problem.target)
            self._places = replace(self._places, swept=self._swept)
        self._rehearsed = {}

    def _certificate(self) -> Certificate | None:
        found = self.slack()
        if found is None:
            return None
        return certify(self._places.model, *found, calls=len(self._rewards), actions=len(self.grid()))

    @property
    def _patience(self) -> int:
        return PATIENCE_REACHED if self._best_reward > REACHED else PATIENCE

    @property
    def _best_reward(self) -> float:
        return max(self._rewards.values(), default=-np.inf)

    def _best_anywhere(self, curiosity: float) -> tuple[float, Float64s]:
        """Return the best of the swept actions, and its score; of the places as long as nothing was simulated."""
        if not self._rewards:
            places = self._places
            scores = self._scores(places.actions, places.rewards, WIDTH * places.widths, 0.0)
            if np.isfinite(scores.max()):
                return float(scores.max()), places.actions[int(scores.argmax())]
        swept = self._places.swept
        found, error = self._discrepancy(swept.actions)
        mean = swept.rewards + found
        if self._rewards:
            near = np.flatnonzero(self._blend.nearest(swept.actions) < NEAR)
            owners = self._blend.owners(swept.actions[near])
            for owner in np.unique(owners):
                part = near[owners == owner]
                mean[part], error[part] = _fused((mean[part], error[part]), self._blend.predict(swept.actions[part]))
        scores = self._scores(swept.actions, mean, error, curiosity)
        return float(scores.max()), swept.actions[int(scores.argmax())]

    def _best_near(self, curiosity: float) -> tuple[float, Float64s]:
        """Return the best action in nested grids around the best simulated one, and its score."""
        centre = self._asked[max(self._rewards, key=self._rewards.__getitem__)]
        score = -np.inf
        for step, side in GRIDS:
            actions = around(centre[None], step * self._unit, side=side, space=self._space)
            scores = self._scores(actions, *self._blend.predict(actions), curiosity)
            if scores.max() > score or not np.isfinite(score):
                score, centre = float(scores.max()), actions[int(scores.argmax())]
        return score, centre

    def _scores(self, actions: Float64s, mean: Float64s, error: Float64s, curiosity: float) -> Float64s:
        """Return ``mean + curiosity error``, lowered near pending actions and impossible at asked ones."""
        scores = mean + curiosity * error
        for index, asked in enumerate(self._asked):
            distance = np.sqrt(((self._space.gaps(actions, asked) / self._unit) ** 2).sum(axis=1))
            if index not in self._rewards:
                scores = scores - error * np.exp(-distance / PENDING)
            scores = np.where(distance < 0.4, -np.inf, scores)
        return scores

    def _compare(self) -> None:
        """Ask the cheap models about what was simulated since; without a model its rewards are 0."""
        if not self._uncompared:
            return
        new, self._uncompared = self._uncompared, []
        actions = np.stack([self._asked[index] for index, _ in new])
        model, survey = self._places.swept.model, self._setting.survey
        cheap = survey.rewards(model, actions) if model else np.zeros(len(actions))
        if cheap is not None:
            self._errors.update({index: self._rewards[index] - own for (index, _), own in zip(new, cheap, strict=True)})
        self._deviate(actions, np.stack([heights for _, heights in new]))

    def _deviate(self, actions: Float64s, outcomes: NDArray[np.float32]) -> None:
        """Find out how far off the MDE is, at actions that are far from those where that is known."""
        chosen: list[int] = []
        for index, action in enumerate(actions):
            gaps = (self._space.gaps(action, known) / (SPREAD * self._unit) for known in self._compared)
            if all((gap**2).sum() >= 1 for gap in gaps):
                self._compared.append(action)
                chosen.append(index)
        model, survey = self._places.model, self._setting.survey
        if not chosen or self._places.estimates is None:
            return
        found = survey.estimates(model, actions[chosen])
        cheap = survey.compare(model, actions[chosen], outcomes[chosen])
        if cheap is not None and found is not None and found.scale_m is not None:
            self._deviations += zip((found.scale_m * found.mean).tolist(), cheap[1].tolist(), strict=True)

    def _discrepancy(self, actions: Float64s) -> tuple[Float64s, Float64s]:
        """Return mean and standard deviation of what the cheapest model gets wrong at actions ``(B, n)`` [m]."""
        swept, known = self._places.swept, list(self._errors)
        simulated = np.array([self._asked[index] for index in known]).reshape(-1, actions.shape[1])
        return discrepancy(
            self._share(np.concatenate([swept.known, simulated])),
            np.concatenate([swept.differences, [self._errors[index] for index in known]]),
            self._pending(),
            self._share(actions),
            noises=np.repeat([CHEAP_NOISE, NOISE], [len(swept.known), len(known)]),
        )

    def _pending(self) -> list[Float64s]:
        return [self._share(asked) for index, asked in enumerate(self._asked) if index not in self._errors]

    def _share(self, actions: Float64s) -> Float64s:
        """Return actions ``(..., n)`` as shares of the range, circles laid out in the plane."""
        return embed(actions / self._range, self._space.circular)


def _fused(one: tuple[Float64s, Float64s], other: tuple[Float64s, Float64s]) -> tuple[Float64s, Float64s]:
    """Return mean and standard deviation of two independent estimates together."""
    weights = 1 / one[1] ** 2, 1 / other[1] ** 2
    total = weights[0] + weights[1]
    return (weights[0] * one[0] + weights[1] * other[0]) / total, 1 / np.sqrt(total)
