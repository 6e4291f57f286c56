"""A plan: which actions one optimisation evaluates, one after the other."""

from abc import ABC, abstractmethod
from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from common.domain.certificate import Certificate
from common.domain.deviation import Estimates
from common.planning.problem import Problem


@dataclass(frozen=True)
class Outcome:
    """What came of an action.

    Attributes:
        model: The model that predicted it.
        reward: Its reward [m].
        heights: The heightmap after it ``(H, W)`` [m].
    """

    model: str
    reward: float
    heights: NDArray[np.float32]


class Survey(Protocol):
    """Cheap models and MDEs, asked about many actions at once; what they say is no trial."""

    def rewards(self, model: str, actions: NDArray[np.float64]) -> NDArray[np.float64] | None:
        """Return the rewards ``(B,)`` [m] of a model's predictions for actions ``(B, n)``; None if it failed."""
        ...

    def outcomes(self, model: str, actions: NDArray[np.float64]) -> NDArray[np.float32] | None:
        """Return a model's predictions ``(B, H, W)`` [m] for actions ``(B, n)``; None if it failed."""
        ...

    def compare(
        self, model: str, actions: NDArray[np.float64], outcomes: NDArray[np.float32]
    ) -> tuple[NDArray[np.float64], NDArray[np.float64]] | None:
        """Return the rewards ``(B,)`` [m] of a model's predictions, and their deviations ``(B,)`` [m] from outcomes.

        None if it failed. The outcomes ``(B, H, W)`` [m] are the trusted model's.
        """
        ...

    def estimates(self, model: str, actions: NDArray[np.float64]) -> Estimates | None:
        """Return what a model's MDE says about actions ``(B, n)``; None if there is none or it failed."""
        ...


@dataclass(frozen=True)
class Setting:
    """What a plan may know and ask.

    Attributes:
        problem: What is to be optimised.
        models: Names of the models, from cheapest to dearest.
        trusted: The model that is always applicable.
        evaluations: Largest number of actions to evaluate.
        seed: Seed of every random choice.
        survey: Asks cheap models about many actions.
    """

    problem: Problem
    models: tuple[str, ...]
    trusted: str
    evaluations: int
    seed: int
    survey: Survey

    @property
    def cheap(self) -> tuple[str, ...]:
        """Names of the models that cost less than the trusted one."""
        if self.trusted not in self.models:
            return self.models
        return self.models[: self.models.index(self.trusted)]

    @property
    def level(self) -> str | None:
        """The cheap model that is a level of the trusted one, as the task says."""
        level = self.problem.task.levels.get(self.trusted)
        return level if level in self.cheap else None


class Plan(ABC):
    """The course of one optimisation. The same answers to the same questions lead to the same next question."""

    @abstractmethod
    def ask(self) -> NDArray[np.float64] | None:
        """Return the next action to evaluate ``(n,)``; None if no more is worth it as things stand.

        Earlier actions may be pending. A plan is asked for at most ``evaluations`` actions.
        """

    @abstractmethod
    def tell(self, index: int, outcome: Outcome | None) -> None:
        """Learn what came of action ``index``, counted from 0 in the order of asking; None if nobody could tell."""

    def certificate(self) -> Certificate | None:
        """Return how much better than the best action told another one may be; None if the plan cannot say."""
        return None
