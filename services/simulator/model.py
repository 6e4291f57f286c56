"""The simulator as a predictive model: an item is lowered on a plate of fries and comes to rest."""

from __future__ import annotations

import threading
from collections import OrderedDict
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from common.domain.bodies import Bodies
from common.domain.errors import RequestError
from common.domain.grid import Floats
from common.domain.model import PredictiveModel
from common.domain.scene import State
from services.simulator.settings import LEVELS, Settings

if TYPE_CHECKING:
    from services.simulator.placement import Placement

STATES = 8
"""States whose meshes and arrays are kept."""


class SimulatorModel(PredictiveModel):
    """Simulate the placement: soft or rigid item, plate, boxes that move, tray, friction. Always applicable.

    The same state and action give the same bits, in any order and batch. Threads that ask at once take turns.

    Args:
        settings: Resolution and laws, by default `LEVELS`' ``default``.
        device: Warp's name of the device.
        name: What it is called; a level other than ``default`` is a model of its own, see `at_level`.
    """

    name = "simulator"
    version = "2"

    def __init__(self, *, settings: Settings = LEVELS["default"], device: str = "cpu", name: str = "simulator") -> None:
        self.settings = settings
        self.device = device
        self.name = name
        self._placements: OrderedDict[str, Placement] = OrderedDict()
        self._turn = threading.Lock()

    @classmethod
    def at_level(cls, level: str, *, device: str = "cpu") -> SimulatorModel:
        """Return the simulator at one of `LEVELS`: ``simulator`` at ``default``, else ``simulator_<level>``.

        Raises:
            RequestError: There is no such level.
        """
        if level not in LEVELS:
            raise RequestError(f"expected a level of {', '.join(LEVELS)}, got {level!r}")
        name = cls.name if level == "default" else f"{cls.name}_{level}"
        return cls(settings=LEVELS[level], device=device, name=name)

    def outcomes(self, state: State, actions: NDArray[np.float64]) -> tuple[Floats, tuple[str, ...]]:
        """Return the settled heightmaps ``(B, H, W)`` [m]; a warning says if a placement did not come to rest.

        Raises:
            RequestError: The state cannot be simulated: an item that does not fit, an action off the grid.
            ModelError: The scene's bodies were not found, or do not come to rest.
        """
        with self._turn:
            return self._outcomes(self.placement(state), actions)

    def _outcomes(self, placement: Placement, actions: NDArray[np.float64]) -> tuple[Floats, tuple[str, ...]]:
        heights: list[NDArray[np.float32]] = []
        warnings: list[str] = []
        for start in range(0, len(actions), placement.count):
            placed = placement.run(actions[start : start + placement.count])
            heights.append(placed.heights)
            warnings += [
                "" if settled else f"not_settled: {1e3 * speed:.1f} mm/s after {time:.2f} s"
                for settled, speed, time in zip(placed.settled, placed.speed, placed.time, strict=True)
            ]
        return np.concatenate(heights), tuple(warnings)

    def placement(self, state: State) -> Placement:
        """Return what depends on the state alone, made once and kept for the last few states."""
        if state.digest in self._placements:
            self._placements.move_to_end(state.digest)
            return self._placements[state.digest]
        from services.simulator.placement import Placement

        # On a CPU one world at a time keeps its matrices in the cache; launches are cheap there.
        placement = Placement(state, self._bodies(state), settings=self.settings, worlds=1, device=self.device)
        self._placements[state.digest] = placement
        while len(self._placements) > STATES:
            self._placements.popitem(last=False)
        return placement

    def warm(self) -> None:
        """Compile or load all kernels, so that the first placement does not wait for it."""
        import warp as wp

        from services.simulator import placement
        from services.simulator.device import MODULE

        del placement  # imported for its kernels
        wp.load_module(MODULE, device=self.device)

    def _bodies(self, state: State) -> Bodies:
        known = state.scene.bodies
        if known is not None and known.plate is not None:
            return known
        from services.simulator.perception import find_bodies
        from services.simulator.settle import settle_boxes

        found = find_bodies(state.scene)
        assert found.plate is not None
        if known is not None:
            return Bodies(found.plate, known.boxes)
        return Bodies(found.plate, settle_boxes(found.plate, found.boxes, settings=self.settings, device=self.device))
