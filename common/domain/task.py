"""A task: what an action means, and how good its outcome is."""

from abc import ABC, abstractmethod
from collections.abc import Mapping
from types import MappingProxyType

import numpy as np
from numpy.typing import NDArray

from common.domain.deviation import DeviationEstimator, deviation
from common.domain.errors import RequestError
from common.domain.grid import Floats
from common.domain.model import PredictiveModel
from common.domain.parameter import Parameter, X, Y
from common.domain.scene import State
from common.domain.transport import Transport


class Task(ABC):
    """One family of action selection problems.

    Attributes:
        name: The word in the keys.
        trusted: The model that is always applicable.
        parameters: What an action consists of.
        levels: By the name of a model the cheaper level of it that is worth optimising before it.
    """

    name: str
    trusted: str
    levels: Mapping[str, str] = MappingProxyType({})
    parameters: tuple[Parameter, ...] = (X, Y)

    @property
    def names(self) -> tuple[str, ...]:
        """The names of the action's parameters."""
        return tuple(parameter.name for parameter in self.parameters)

    @abstractmethod
    def bounds(self, state: State) -> NDArray[np.float64]:
        """Return the smallest and largest value of each action parameter ``(n, 2)``."""

    def transport(self, state: State, action: NDArray[np.float64], outcome: Floats) -> Transport | None:
        """Return what the outcome ``(H, W)`` [m] of an action ``(n,)`` says about nearby actions; None: nothing."""
        return None

    def adapt_model(self, model: PredictiveModel) -> PredictiveModel:
        """Return a model of this task's actions: the given one, or what the task makes of it.

        Raises:
            RequestError: It takes other parameters.
        """
        self._check_taken(model.name, model.takes)
        return model

    def adapt_estimator(self, estimator: DeviationEstimator) -> DeviationEstimator:
        """Return an MDE of this task's actions, as `adapt_model` does for models."""
        self._check_taken(f"MDE of {estimator.model}", estimator.takes)
        return estimator

    def _check_taken(self, name: str, takes: tuple[tuple[str, ...], ...]) -> None:
        if takes and self.names not in takes:
            forms = " or ".join(f"({', '.join(names)})" for names in takes)
            raise RequestError(f"{name}: expected one that takes ({', '.join(self.names)}) in {self.name}, got {forms}")

    def reward(self, prediction: Floats, target: Floats) -> NDArray[np.float64]:
        """Return ``r(s_T, s_g) = -d(s_T, s_g)`` [m] for predictions ``(..., H, W)`` and a target ``(H, W)``."""
        return -deviation(prediction, target)
