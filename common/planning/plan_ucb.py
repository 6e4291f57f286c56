"""The paper's plan: GP-UCB over the actions, as many as were asked for."""

from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from common.planning.plan import Outcome, Plan, Setting
from common.planning.planner import Planner
from common.planning.space import Space


class MakePlanner(Protocol):
    """Makes a planner of an optimisation, `Planner` or one that asks the same way."""

    def __call__(self, bounds: NDArray[np.float64], *, seed: int, circular: NDArray[np.bool_] | None = None) -> Planner:
        """Return a planner for bounds ``(n, 2)``; some parameters may be circles ``(n,)``."""
        ...


class UcbPlan(Plan):
    """Ask where the upper confidence bound of the reward is highest, see `Planner`.

    Args:
        setting: The optimisation.
        make_planner: Makes what chooses the actions.
    """

    def __init__(self, setting: Setting, *, make_planner: MakePlanner = Planner) -> None:
        space = Space.of(setting.problem)
        self._planner = make_planner(space.limits, seed=setting.seed, circular=space.circular)

    def ask(self) -> NDArray[np.float64]:
        """Return the next action ``(n,)``."""
        return self._planner.ask()[1]

    def tell(self, index: int, outcome: Outcome | None) -> None:
        """Learn the reward of an action."""
        self._planner.tell(index, None if outcome is None else outcome.reward)
