"""Sweeps: many actions asked of a cheap model or an MDE in batches, counted but not kept one by one."""

from collections import Counter
from collections.abc import Callable, Mapping
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from common.domain.deviation import DeviationEstimator, Estimates, deviation
from common.domain.model import Event, Predictions, PredictiveModel
from common.domain.trial import Trial
from common.planning.estimation import RECOVERABLE, failure_event, unfamiliar_event
from common.planning.problem import Problem

LARGEST_BATCH = 64
"""Most heightmaps in one answer: a few MB, which caches and messages hold."""


Answer = Predictions | Estimates


class Sweeps:
    """The sweeps of one optimisation, a `Survey`.

    Args:
        problem: What is to be optimised.
        models: Models by name.
        estimators: MDEs by the name of their model.
        now: Seconds since the optimisation began.
        wait_for: Runs a function and returns what it returns; raises when nobody waits any more.

    Attributes:
        usage: Actions asked, by model.
        versions: Version by model that answered.
        mdes: Versions of the MDEs that answered, by model and in their order.
        split_s: Time by model, and for ``mde`` and ``transport`` [s].
        events: What went wrong.
        best: The best action seen, as a trial, with its heightmap ``(H, W)`` [m]; None before the first answer.
    """

    def __init__(
        self,
        problem: Problem,
        models: Mapping[str, PredictiveModel],
        estimators: Mapping[str, DeviationEstimator],
        *,
        now: Callable[[], float],
        wait_for: Callable[[Callable[[], Answer]], Answer],
    ) -> None:
        self._problem = problem
        self._models = models
        self._estimators = estimators
        self._now = now
        self._wait_for = wait_for
        self.usage = Counter[str]()
        self.versions: dict[str, str] = {}
        self.mdes: dict[str, dict[str, None]] = {}
        self.split_s: dict[str, float] = {}
        self.events: list[Event] = []
        self._unfamiliar: set[str] = set()
        self.best: tuple[Trial, NDArray[np.float32]] | None = None

    def rewards(self, model: str, actions: NDArray[np.float64]) -> NDArray[np.float64] | None:
        """Return the rewards ``(B,)`` [m] of a model's predictions for actions ``(B, n)``; None if it failed."""
        return self._predict(model, actions, lambda part, heights: None)

    def outcomes(self, model: str, actions: NDArray[np.float64]) -> NDArray[np.float32] | None:
        """Return a model's predictions ``(B, H, W)`` [m] for actions ``(B, n)``; None if it failed."""
        found: list[NDArray[np.float32]] = []
        rewards = self._predict(model, actions, lambda part, heights: found.append(heights.copy()))
        return None if rewards is None else np.concatenate(found)

    def compare(
        self, model: str, actions: NDArray[np.float64], outcomes: NDArray[np.float32]
    ) -> tuple[NDArray[np.float64], NDArray[np.float64]] | None:
        """Return rewards and deviations from outcomes ``(B, H, W)`` [m], both ``(B,)`` [m]; None if it failed."""
        deviations = np.empty(len(actions))

        def keep(part: slice, heights: NDArray[np.float32]) -> None:
            deviations[part] = deviation(heights, outcomes[part])

        rewards = self._predict(model, actions, keep)
        return None if rewards is None else (rewards, deviations)

    def _predict(
        self, model: str, actions: NDArray[np.float64], keep: Callable[[slice, NDArray[np.float32]], None]
    ) -> NDArray[np.float64] | None:
        source = self._models[model]
        rewards = np.empty(len(actions))
        for part in _parts(len(actions), source.largest_batch):
            began = self._now()
            answer = self._ask(model, lambda part=part: source.predict(self._problem.state, actions[part]), began)
            if not isinstance(answer, Predictions):
                return None
            self._account(model, answer.compute_s, began, answer.events)
            began = self._now()
            task, target = self._problem.task, self._problem.target
            rewards[part] = [float(task.reward(heights, target)) for heights in answer.heights]  # one by one: in cache
            keep(part, answer.heights)
            self._add("optimiser", self._now() - began)
            self.usage[model] += len(answer.heights)
            self.versions[model] = answer.version
            self._keep_best(answer, actions[part], rewards[part], began)
        return rewards

    def estimates(self, model: str, actions: NDArray[np.float64]) -> Estimates | None:
        """Return what a model's MDE says about actions ``(B, n)``; None if there is none or it failed."""
        if model not in self._estimators:
            return None
        source = self._estimators[model]
        answers: list[Estimates] = []
        for part in _parts(len(actions), source.largest_batch, most=len(actions)):
            began = self._now()
            answer = self._ask(
                f"mde/{model}", lambda part=part: source.estimate(self._problem.state, actions[part]), began
            )
            if not isinstance(answer, Estimates):
                return None
            self._account("mde", answer.compute_s, began, answer.events)
            if answer.version:
                self.mdes.setdefault(model, {})[answer.version] = None
            answers.append(answer)
        found = replace(
            answers[0],
            mean=np.concatenate([answer.mean for answer in answers]),
            upper=np.concatenate([answer.upper for answer in answers]),
            familiar=np.concatenate([answer.familiar for answer in answers]),
        )
        if not found.familiar.any() and model not in self._unfamiliar:
            self._unfamiliar.add(model)
            self.events.append(replace(unfamiliar_event(found, f"mde/{model}"), time=self._now()))
        return found

    def _ask(self, worker: str, question: Callable[[], Answer], began: float) -> Answer | None:
        try:
            return self._wait_for(question)
        except RECOVERABLE as error:
            self._add("transport", self._now() - began)
            self.events.append(replace(failure_event(error, worker), time=self._now()))
            return None

    def _account(self, name: str, compute_s: float | None, began: float, events: tuple[Event, ...]) -> None:
        wall_s = self._now() - began
        compute_s = wall_s if compute_s is None else min(compute_s, wall_s)
        self._add(name, compute_s)
        self._add("transport", wall_s - compute_s)
        self.events += [replace(event, time=self._now()) for event in events]

    def _add(self, name: str, seconds: float) -> None:
        self.split_s[name] = self.split_s.get(name, 0.0) + seconds

    def _keep_best(
        self, answer: Predictions, actions: NDArray[np.float64], rewards: NDArray[np.float64], started_s: float
    ) -> None:
        place = int(rewards.argmax())
        if self.best is not None and self.best[0].reward is not None and self.best[0].reward >= rewards[place]:
            return
        trial = Trial(
            index=0,
            action=tuple(actions[place].tolist()),
            model=answer.model,
            instance=answer.instance,
            version=answer.version,
            reward=float(rewards[place]),
            warning=answer.warnings[place],
            started_s=started_s,
        )
        self.best = trial, answer.heights[place].copy()


def _parts(count: int, largest: int, *, most: int = LARGEST_BATCH) -> list[slice]:
    size = max(min(largest, most), 1)
    return [slice(start, start + size) for start in range(0, count, size)]
