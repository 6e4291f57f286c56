"""What an MDE is worth: the same strategy with one that knows nothing, everything, or not what it does not know."""

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from common.domain.deviation import DeviationEstimator, Estimates, deviation
from common.domain.errors import RequestError
from common.domain.model import PredictiveModel
from common.domain.scene import State
from pipelines.evaluate.strategies_meter import Meter

CONTROLS = ("constant-mde", "oracle-mde")
TRUSTING = "trusting"
"""The option under which no input is unfamiliar to an MDE."""


@dataclass(frozen=True)
class Scaling:
    """What the card of an MDE says about its training data.

    Attributes:
        scale_m: The deviation that counts as 1 [m].
        mean: Mean deviation of the training samples, scaled.
    """

    scale_m: float
    mean: float


class ConstantEstimator(DeviationEstimator):
    """The same deviation for every action: the mean of the training data.

    Args:
        model: Name of the model.
        scaling: What the replaced MDE's card says.
    """

    version = "constant"

    def __init__(self, model: str, scaling: Scaling) -> None:
        self.model = model
        self._scaling = scaling

    def deviations(self, state: State, actions: NDArray[np.float64]) -> Estimates:
        """Return the mean ``(B,)``."""
        mean = np.full(len(actions), self._scaling.mean)
        return Estimates(mean, mean, np.ones(len(actions), dtype=bool), scale_m=self._scaling.scale_m)


class TrustingEstimator(DeviationEstimator):
    """An MDE that says of every input that it knows such inputs, as the paper's do.

    Args:
        estimator: The MDE.
    """

    def __init__(self, estimator: DeviationEstimator) -> None:
        self.model, self.version, self.largest_batch = estimator.model, estimator.version, estimator.largest_batch
        self._estimator = estimator

    def deviations(self, state: State, actions: NDArray[np.float64]) -> Estimates:
        """Return the MDE's estimates ``(B,)``, all familiar."""
        found = self._estimator.estimate(state, actions)
        return replace(found, familiar=np.ones(len(actions), dtype=bool), reason="")


class OracleEstimator(DeviationEstimator):
    """The true deviation, by simulating every action; nobody pays for its time.

    Args:
        fast: The cheap model.
        trusted: The trusted one.
        scaling: What the replaced MDE's card says.
        meter: The clocks that stand still.
    """

    version = "oracle"

    def __init__(self, fast: PredictiveModel, trusted: PredictiveModel, scaling: Scaling, meter: Meter) -> None:
        self.model = fast.name
        self._fast = fast
        self._trusted = trusted
        self._scaling = scaling
        self._meter = meter

    def deviations(self, state: State, actions: NDArray[np.float64]) -> Estimates:
        """Return the scaled deviations ``(B,)``."""
        with self._meter.unpaid():
            true = np.array([self._one(state, action[None]) for action in actions])
        scaled = np.clip(true / self._scaling.scale_m, 0, 1)
        return Estimates(scaled, scaled, np.ones(len(actions), dtype=bool), scale_m=self._scaling.scale_m)

    def _one(self, state: State, action: NDArray[np.float64]) -> float:
        fast, true = self._fast.predict(state, action), self._trusted.predict(state, action)
        return float(deviation(fast.heights[0], true.heights[0]))


def controlled(
    control: str,
    models: Mapping[str, PredictiveModel],
    scalings: Mapping[str, Scaling],
    *,
    trusted: PredictiveModel,
    meter: Meter,
) -> dict[str, DeviationEstimator]:
    """Return an MDE by the name of its model for every one that a control replaces.

    Raises:
        RequestError: There is none to replace.
    """
    if not scalings:
        raise RequestError(f"{control}: expected an MDE to replace, got none with released weights")
    if control == "constant-mde":
        return {name: ConstantEstimator(name, scaling) for name, scaling in scalings.items()}
    return {name: OracleEstimator(models[name], trusted, scaling, meter) for name, scaling in scalings.items()}
