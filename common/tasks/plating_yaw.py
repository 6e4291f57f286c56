"""Plating with yaw: the item may also be turned about its centre before it is placed."""

import numpy as np
from numpy.typing import NDArray

from common.domain.deviation import DeviationEstimator
from common.domain.grid import Floats
from common.domain.model import PredictiveModel
from common.domain.parameter import YAW, X, Y
from common.domain.scene import State
from common.domain.transport import Transport
from common.tasks.plating import Plating
from common.tasks.plating_turn import TurnedEstimator, TurnedModel
from common.tasks.plating_yaw_transport import PlatingYawTransport


class PlatingYaw(Plating):
    """The item's centre (x, y) as in `Plating`, and its yaw, counter-clockwise from the pose that the state shows.

    All turns are allowed: items need no symmetry. Bounds of less than a full turn are no circle.
    """

    name = "plating_yaw"
    parameters = (X, Y, YAW)

    def bounds(self, state: State) -> NDArray[np.float64]:
        """Return those of `Plating` [m] and a full turn [rad] ``(3, 2)``."""
        return np.vstack([super().bounds(state), [-np.pi, np.pi]])

    def transport(self, state: State, action: NDArray[np.float64], outcome: Floats) -> Transport:
        """Return the settled surface as it moves and turns with the item."""
        return PlatingYawTransport(state, action, outcome)

    def adapt_model(self, model: PredictiveModel) -> PredictiveModel:
        """Return the model, or where it takes (x, y) alone one that turns its states."""
        if model.takes and self.names not in model.takes and (X.name, Y.name) in model.takes:
            return TurnedModel(model)
        return super().adapt_model(model)

    def adapt_estimator(self, estimator: DeviationEstimator) -> DeviationEstimator:
        """Return the MDE, or where it takes (x, y) alone one that turns its states."""
        if estimator.takes and self.names not in estimator.takes and (X.name, Y.name) in estimator.takes:
            return TurnedEstimator(estimator)
        return super().adapt_estimator(estimator)
