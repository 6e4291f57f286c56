"""The simulator as a predictive model: an item is lowered on a plate of fries and comes to rest."""

from __future__ import annotations

import queue
import threading
from collections import OrderedDict
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
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
    from services.simulator.placement import Placed, Placement

STATES = 4
"""States whose meshes and arrays are kept."""


class SimulatorModel(PredictiveModel):
    """Simulate the placement: soft or rigid item, plate, boxes that move, tray, friction. Always applicable.

    The same state and action give the same bits, in any order and batch. Threads that ask at once take turns.

    Args:
        settings: Resolution and laws, by default `LEVELS`' ``default``.
        device: Warp's name of the device.
        threads: Actions of one batch that are simulated at the same time on a CPU; they share nothing but the state.
        name: What it is called; a level other than ``default`` is a model of its own, see `at_level`.
    """

    name = "simulator"
    version = "3"
    takes = (("x", "y"), ("x", "y", "yaw"))

    def __init__(
        self,
        *,
        settings: Settings = LEVELS["default"],
        device: str = "cpu",
        threads: int = 1,
        name: str = "simulator",
    ) -> None:
        self.settings = settings
        self.device = device
        self.threads = threads
        self.name = name
        self._placements: OrderedDict[str, list[Placement]] = OrderedDict()
        self._turn = threading.Lock()

    @classmethod
    def at_level(cls, level: str, *, device: str = "cpu", threads: int = 1) -> SimulatorModel:
        """Return the simulator at one of `LEVELS`: ``simulator`` at ``default``, else ``simulator_<level>``.

        Raises:
            RequestError: There is no such level.
        """
        if level not in LEVELS:
            raise RequestError(f"expected a level of {', '.join(LEVELS)}, got {level!r}")
        name = cls.name if level == "default" else f"{cls.name}_{level}"
        return cls(settings=LEVELS[level], device=device, threads=threads, name=name)

    def outcomes(self, state: State, actions: NDArray[np.float64]) -> tuple[Floats, tuple[str, ...]]:
        """Return the settled heightmaps ``(B, H, W)`` [m]; a warning says if a placement did not come to rest.

        Actions are ``(B, 2)`` [m] or, with a turn of the item about its centre, ``(B, 3)`` [m, m, rad]. Bodies and mesh
        are turned as they are: nothing is meshed or drawn again.

        Raises:
            RequestError: The state cannot be simulated: an item that does not fit, an action off the grid.
            ModelError: The scene's bodies were not found, or do not come to rest.
        """
        with self._turn:
            worlds = self._worlds
            parts = [actions[start : start + worlds] for start in range(0, len(actions), worlds)]
            placements = self._prepared(state, count=min(self.threads, len(parts)))
            if len(placements) == 1:
                placed = [placements[0].run(part) for part in parts]
            else:
                placed = _run_in_threads(placements, parts)
        warnings = [
            "" if settled else f"not_settled: {1e3 * speed:.1f} mm/s after {time:.2f} s"
            for part in placed
            for settled, speed, time in zip(part.settled, part.speed, part.time, strict=True)
        ]
        return np.concatenate([part.heights for part in placed]), tuple(warnings)

    def placement(self, state: State) -> Placement:
        """Return what depends on the state alone, made once and kept for the last few states."""
        return self._prepared(state, count=1)[0]

    @property
    def _worlds(self) -> int:
        # On a CPU one world at a time keeps its matrices in the cache; launches are cheap there.
        return 1 if self.device == "cpu" else self.largest_batch

    def _prepared(self, state: State, *, count: int) -> list[Placement]:
        """Return ``count`` equal placements of a state, one for each thread."""
        from services.simulator.placement import Placement

        kept = self._placements.setdefault(state.digest, [])
        self._placements.move_to_end(state.digest)
        try:
            while len(kept) < count:
                bodies = Bodies(kept[0].plate, kept[0].boxes) if kept else self._bodies(state)
                kept.append(Placement(state, bodies, settings=self.settings, worlds=self._worlds, device=self.device))
        finally:
            if not kept:
                del self._placements[state.digest]
        while len(self._placements) > STATES:
            self._placements.popitem(last=False)
        return kept[:count]

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
        from services.simulator.placement import keep_apart
        from services.simulator.settle import settle_boxes

        found = find_bodies(state.scene)
        assert found.plate is not None
        if known is not None:
            return Bodies(found.plate, known.boxes)
        boxes, count = found.boxes, -1
        while len(boxes) != count:
            settled = settle_boxes(found.plate, boxes, settings=self.settings, device=self.device)
            count, boxes = len(boxes), keep_apart(settled)
        return Bodies(found.plate, boxes)


def _run_in_threads(placements: Sequence[Placement], parts: Sequence[NDArray[np.float64]]) -> list[Placed]:
    """Run every part on one of the placements, each thread taking the next part when it is free."""
    free: queue.SimpleQueue[Placement] = queue.SimpleQueue()
    for placement in placements:
        free.put(placement)

    def run(part: NDArray[np.float64]) -> Placed:
        placement = free.get()
        try:
            return placement.run(part)
        finally:
            free.put(placement)

    with ThreadPoolExecutor(len(placements)) as pool:
        return list(pool.map(run, parts))
