"""What an MDE is worth: the same strategy with one that knows nothing, and with one that knows everything."""

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from common.domain.deviation import DeviationEstimator, Estimates, deviation
from common.domain.model import PredictiveModel
from common.domain.scene import State

TRAINING_MEAN = 0.35
"""Mean deviation of training samples, scaled to [0, 1]."""
SCALE = 2.5e-3
"""Deviation that is scaled to 1 [m]."""


class ConstantEstimator(DeviationEstimator):
    """The same deviation for every action: the mean of the training data.

    Args:
        replaced: The MDE whose place it takes.
    """

    version = "constant"

    def __init__(self, replaced: DeviationEstimator) -> None:
        self.model = replaced.model

    def deviations(self, state: State, actions: NDArray[np.float64]) -> Estimates:
        """Return the mean ``(B,)``."""
        mean = np.full(len(actions), TRAINING_MEAN)
        return Estimates(mean, mean, np.ones(len(actions), dtype=bool))


class OracleEstimator(DeviationEstimator):
    """The true deviation, by simulating every action; its time means nothing.

    Args:
        fast: The cheap model.
        simulator: The trusted one.
    """

    version = "oracle"

    def __init__(self, fast: PredictiveModel, simulator: PredictiveModel) -> None:
        self.model = fast.name
        self._fast = fast
        self._simulator = simulator

    def deviations(self, state: State, actions: NDArray[np.float64]) -> Estimates:
        """Return the scaled deviations ``(B,)``."""
        true = np.array([self._one(state, action[None]) for action in actions])
        scaled = np.clip(true / SCALE, 0, 1)
        return Estimates(scaled, scaled, np.ones(len(actions), dtype=bool))

    def _one(self, state: State, action: NDArray[np.float64]) -> float:
        fast, true = self._fast.predict(state, action), self._simulator.predict(state, action)
        return float(deviation(fast.heights[0], true.heights[0]))


CONTROLS: dict[str, Callable[[DeviationEstimator, PredictiveModel, PredictiveModel], DeviationEstimator]] = {
    "constant-mde": lambda replaced, fast, simulator: ConstantEstimator(replaced),
    "oracle-mde": lambda replaced, fast, simulator: OracleEstimator(fast, simulator),
}
"""Swap an MDE, given the cheap model and the simulator."""
