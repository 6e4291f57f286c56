"""How the outcome of a placement moves with the action where the item may be turned: the surface turns with it."""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from common.domain.grid import Floats
from common.domain.heightmap import turn_taps
from common.domain.parameter import YAW, X, Y, differences
from common.domain.scene import State
from common.domain.transport import Transport, Window
from common.tasks.plating_transport import PlatingTransport
from common.tasks.plating_turn import turned_heights

KEPT = 32
"""Turned surfaces that are kept, 70 kB each."""


class PlatingYawTransport(Transport):
    """Turn the settled surface ``S_k`` of ``a_k`` about the item's centre by the difference in yaw, then move it.

    In the formula of `PlatingTransport` the turned surface is shifted, and ``m(a)`` is of the item as the yaw of ``a``
    turns it. Where the yaws are equal the answer is that of `PlatingTransport` to the bit.

    Args:
        state: Scene and item.
        action: The action ``a_k`` ``(3,)`` [m, m, rad].
        outcome: Its outcome ``S_k`` ``(H, W)`` [m].
    """

    def __init__(self, state: State, action: NDArray[np.float64], outcome: Floats) -> None:
        self._state = state
        self._action = np.asarray(action, dtype=np.float64)
        self.outcome = np.asarray(outcome, dtype=np.float32)
        self._before = turned_heights(state.item.heights, state.grid, float(self._action[2]))
        rows, columns = np.nonzero(state.item.heights)
        squares = state.grid.x[columns] ** 2 + state.grid.y[rows] ** 2
        self._radius, self._reach = float(np.sqrt(squares.mean())), float(np.sqrt(squares.max()))
        self._turned: dict[float, PlatingTransport] = {}

    def window(self, actions: NDArray[np.float64]) -> Window:
        """Return the cells that the item may reach, however it is turned."""
        grid = self._state.grid
        places = (np.vstack([actions, self._action])[:, 1::-1] / grid.cell) + (np.array(grid.shape) - 1) / 2
        reach = self._reach / grid.cell + 2
        low = np.clip(np.floor(places.min(axis=0) - reach).astype(int), 0, grid.shape)
        high = np.clip(np.ceil(places.max(axis=0) + reach).astype(int) + 1, 0, grid.shape)
        return slice(int(low[0]), int(high[0])), slice(int(low[1]), int(high[1]))

    def patches(
        self, actions: NDArray[np.float64], window: Window, shared: dict[Any, Any] | None = None
    ) -> NDArray[np.float32]:
        """Return the new surface in a window ``(B, h, w)`` [m] for actions ``(B, 3)``."""
        patches = np.empty((len(actions), *self.outcome[window].shape), dtype=np.float32)
        shared = {} if shared is None else shared
        for yaw in np.unique(actions[:, 2]):
            same = actions[:, 2] == yaw
            of_yaw = shared.setdefault(float(yaw), {})
            patches[same] = self._at(float(yaw)).patches(actions[same, :2], window, of_yaw)
        return patches

    def distances(self, actions: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return how far the item's points are displaced, root mean square ``(B,)`` [m].

        ``d^2 = |a - a_k|^2 + (rho dyaw)^2`` with the item's radius of gyration ``rho``.
        """
        gaps = differences((X, Y, YAW), actions, self._action)
        return np.hypot(np.linalg.norm(gaps[:, :2], axis=1), self._radius * gaps[:, 2])

    def aligned(self) -> NDArray[np.float32]:
        """Return the settled surface at the item's cells ``(p,)`` [m], as if it lay at the grid's centre at yaw 0."""
        return self._at(0.0).aligned()

    def _at(self, yaw: float) -> PlatingTransport:
        """Return the transport to actions of one yaw."""
        if yaw not in self._turned:
            while len(self._turned) >= KEPT:
                self._turned.pop(next(iter(self._turned)))
            self._turned[yaw] = self._make(yaw)
        return self._turned[yaw]

    def _make(self, yaw: float) -> PlatingTransport:
        state = self._state
        after = turned_heights(state.item.heights, state.grid, yaw)
        return PlatingTransport(
            state, self._action[:2], self.outcome, carried=self._carried(yaw), before=self._before, after=after
        )

    def _carried(self, yaw: float) -> NDArray[np.float32]:
        """Return the settled surface turned about ``a_k`` as far as the item may lie there ``(H, W)`` [m]."""
        angle = yaw - float(self._action[2])
        if angle == 0:
            return self.outcome
        grid = self._state.grid
        centre = self._action[1::-1] / grid.cell + (np.array(grid.shape) - 1) / 2
        window = self.window(self._action[None])
        taps = turn_taps(grid.shape, angle, centre=(float(centre[0]), float(centre[1])), window=window)
        carried = self.outcome.copy()
        carried[window] = (taps.weights * self.outcome[taps.rows, taps.columns]).sum(axis=0)
        return carried
