"""The paper's plan: GP-UCB over the actions, as many as were asked for."""

import numpy as np
from numpy.typing import NDArray

from common.planning.plan import Outcome, Plan, Setting
from common.planning.planner import Planner
from common.planning.space import Space


class UcbPlan(Plan):
    """Ask where the upper confidence bound of the reward is highest, see `Planner`."""

    def __init__(self, setting: Setting) -> None:
        space = Space.of(setting.problem)
        self._planner = Planner(space.limits, seed=setting.seed, circular=space.circular)

    def ask(self) -> NDArray[np.float64]:
        """Return the next action ``(n,)``."""
        return self._planner.ask()[1]

    def tell(self, index: int, outcome: Outcome | None) -> None:
        """Learn the reward of an action."""
        self._planner.tell(index, None if outcome is None else outcome.reward)
