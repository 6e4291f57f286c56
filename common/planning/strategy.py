"""A strategy: which actions to evaluate, and which models to try for each of them, in which order."""

from abc import ABC, abstractmethod
from collections.abc import Callable, Iterator
from dataclasses import dataclass

from common.planning.plan import Plan, Setting
from common.planning.plan_ucb import UcbPlan


@dataclass(frozen=True)
class Estimate:
    """What an MDE says about one action.

    Attributes:
        mean: Expected deviation, scaled to [0, 1] as ``d_max`` is.
        upper: Calibrated upper bound of it.
        familiar: Whether state and action resemble the estimator's training data.
        version: Version of the MDE, empty if it does not say.
    """

    mean: float
    upper: float
    familiar: bool
    version: str = ""


@dataclass(frozen=True)
class Query:
    """One action whose outcome is wanted.

    Attributes:
        index: Order of asking, from 0.
        models: Names of the models, from cheapest to dearest.
        estimable: Names of the models that have an MDE.
        trusted: The model that is always applicable.
        d_max: Deviation below which a model is applicable, scaled to [0, 1].
        seed: Seed of the optimisation.
        estimate: Ask a model's MDE about this action; None if there is none or it failed. Every call costs time, so
            ask only for what the choice needs.
    """

    index: int
    models: tuple[str, ...]
    estimable: frozenset[str]
    trusted: str
    d_max: float
    seed: int
    estimate: Callable[[str], Estimate | None]


class Strategy(ABC):
    """A way to choose actions and models. Stateless: the same query always gets the same answer."""

    name: str

    @abstractmethod
    def required(self, trusted: str) -> str:
        """Return the model without which this strategy cannot run."""

    @abstractmethod
    def order(self, query: Query) -> Iterator[str]:
        """Yield models to try until one of them predicts the outcome, the required one last."""

    def plan(self, setting: Setting) -> Plan:
        """Return the course of an optimisation: the paper's GP-UCB, unless the strategy has its own."""
        return UcbPlan(setting)

    def budget(self, evaluations: int) -> int:
        """Return how many actions it evaluates at most where ``evaluations`` are allowed."""
        return evaluations
