"""Models that tests serve with `frugal serve model`."""

import os
import time

import numpy as np
from numpy.typing import NDArray

from common.domain.grid import Floats
from common.domain.scene import State
from services.heuristic import HeuristicModel


class QuickSimulator(HeuristicModel):
    """Stands where the simulator would, as fast as the heuristic."""

    name = "simulator"
    version = "quick"


class CountedSimulator(QuickSimulator):
    """Takes 0.1 s, thinks a little otherwise than the heuristic, and writes every action that it answered into a file.

    The environment variable ``COUNTED_ACTIONS`` names the file.
    """

    version = "counted"

    @classmethod
    def predicted(cls, state: State, actions: NDArray[np.float64]) -> Floats:
        """Return heightmaps without counting them."""
        return 0.9 * HeuristicModel().outcomes(state, actions)[0]

    def outcomes(self, state: State, actions: NDArray[np.float64]) -> tuple[Floats, tuple[str, ...]]:
        time.sleep(0.1)
        heights = self.predicted(state, actions)
        with open(os.environ["COUNTED_ACTIONS"], "a") as counted:
            counted.writelines(f"{action.tolist()}\n" for action in actions)
        return heights, ("",) * len(actions)
