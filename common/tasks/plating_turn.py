"""An action (x, y, yaw) in a state is the action (x, y) in the state whose item was turned by yaw about its centre."""

import threading
from collections import OrderedDict
from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

from common.domain.deviation import DeviationEstimator, Estimates
from common.domain.errors import RequestError
from common.domain.grid import Floats, Grid
from common.domain.heightmap import Taps, turn_taps
from common.domain.model import PredictiveModel
from common.domain.scene import Item, State

KEPT = 64
"""Turned states that are kept, about 150 kB each."""


def turned_item(item: Item, grid: Grid, yaw: float) -> Item:
    """Return the item turned counter-clockwise about the grid's centre; at yaw 0 it is the same to the bit.

    A cell belongs to the outline where at least half of it is covered, by bilinear weights: outline and area stay. Its
    thickness is the weighted mean of the covered cells below it, its material that of the nearest of them: neither
    blends with what is outside. Thickness and volume stay within 1 %.

    Args:
        item: The item.
        grid: Its grid.
        yaw: Of the turn [rad].

    Raises:
        RequestError: The turned item does not fit on the grid.
    """
    if yaw == 0:
        return item
    taps, covered, share = _covered_taps(item.heights, grid, yaw)
    thickness = _thickness(item.heights, taps, covered, share)
    nearest = covered.argmax(axis=0)[None]
    rows, columns = (np.take_along_axis(place, nearest, axis=0)[0] for place in (taps.rows, taps.columns))
    heights, materials = np.zeros(grid.shape, dtype=np.float32), np.zeros((3, *grid.shape), dtype=np.float32)
    heights[taps.window] = thickness
    materials[:, *taps.window] = np.where(thickness > 0, item.materials[:, rows, columns], 0)
    return Item(heights, materials)


def turned_heights(heights: NDArray[np.float32], grid: Grid, yaw: float) -> NDArray[np.float32]:
    """Return the heights of `turned_item` alone ``(H, W)`` [m]."""
    if yaw == 0:
        return heights
    turned = np.zeros(grid.shape, dtype=np.float32)
    taps, covered, share = _covered_taps(heights, grid, yaw)
    turned[taps.window] = _thickness(heights, taps, covered, share)
    return turned


def turned_state(state: State, yaw: float) -> State:
    """Return the state with its item turned; at yaw 0 it is the same object."""
    return state if yaw == 0 else State(state.scene, turned_item(state.item, state.grid, yaw))


class _TurnedStates:
    """Turned states, kept for the last `KEPT` pairs of state and yaw. Safe to use from several threads."""

    def __init__(self) -> None:
        self._kept: OrderedDict[tuple[str, float], State] = OrderedDict()
        self._lock = threading.Lock()

    def groups(self, state: State, actions: NDArray[np.float64]) -> Iterator[tuple[NDArray[np.intp], State]]:
        """Yield the indices of the actions ``(B, 3)`` of each yaw, and the state turned by it."""
        yaws, which = np.unique(actions[:, 2], return_inverse=True)
        for group, yaw in enumerate(yaws.tolist()):
            yield np.flatnonzero(which == group), self._turned(state, yaw)

    def _turned(self, state: State, yaw: float) -> State:
        key = state.digest, yaw
        with self._lock:
            if key in self._kept:
                self._kept.move_to_end(key)
                return self._kept[key]
        turned = turned_state(state, yaw)
        with self._lock:
            self._kept[key] = turned
            while len(self._kept) > KEPT:
                self._kept.popitem(last=False)
        return turned


class TurnedModel(PredictiveModel):
    """A model of (x, y) as one of (x, y, yaw): each distinct yaw is one batch in its turned state.

    Args:
        inner: The model of (x, y).
    """

    takes = (("x", "y", "yaw"),)

    def __init__(self, inner: PredictiveModel) -> None:
        self.name = inner.name
        self.version = inner.version
        self.largest_batch = inner.largest_batch
        self._inner = inner
        self._states = _TurnedStates()

    def outcomes(self, state: State, actions: NDArray[np.float64]) -> tuple[Floats, tuple[str, ...]]:
        """Return heightmaps ``(B, H, W)`` [m] and warnings for actions ``(B, 3)`` [m, m, rad]."""
        heights = np.empty((len(actions), *state.grid.shape), dtype=np.float32)
        warnings = [""] * len(actions)
        for indices, turned in self._states.groups(state, actions):
            answer = self._inner.predict(turned, actions[indices, :2])
            heights[indices] = answer.heights
            for index, warning in zip(indices, answer.warnings, strict=True):
                warnings[index] = warning
        return heights, tuple(warnings)


class TurnedEstimator(DeviationEstimator):
    """An MDE of (x, y) as one of (x, y, yaw), as in `TurnedModel`.

    Args:
        inner: The MDE of (x, y).
    """

    takes = (("x", "y", "yaw"),)

    def __init__(self, inner: DeviationEstimator) -> None:
        self.model = inner.model
        self.version = inner.version
        self.largest_batch = inner.largest_batch
        self._inner = inner
        self._states = _TurnedStates()

    def deviations(self, state: State, actions: NDArray[np.float64]) -> Estimates:
        """Return the estimates for actions ``(B, 3)`` [m, m, rad]; the reason is that of the first unfamiliar yaw."""
        mean, upper = np.empty((2, len(actions)))
        familiar = np.empty(len(actions), dtype=np.bool_)
        reason = ""
        for indices, turned in self._states.groups(state, actions):
            answer = self._inner.estimate(turned, actions[indices, :2])
            mean[indices], upper[indices], familiar[indices] = answer.mean, answer.upper, answer.familiar
            reason = reason or answer.reason
        return Estimates(mean, upper, familiar, reason)


def _covered_taps(
    heights: NDArray[np.float32], grid: Grid, yaw: float
) -> tuple[Taps, NDArray[np.float32], NDArray[np.float32]]:
    """Return taps in a window around the turned item, their weights where it is, and the sum of these."""
    rows, columns = np.nonzero(heights)
    middle = (grid.rows - 1) / 2, (grid.columns - 1) / 2
    down, along = rows - middle[0], columns - middle[1]
    cos, sin = np.cos(yaw), np.sin(yaw)
    reach = np.abs(cos * down + sin * along).max(), np.abs(cos * along - sin * down).max()
    if reach[0] > middle[0] + 0.5 or reach[1] > middle[1] + 0.5:
        raise RequestError(f"yaw: expected an item that fits on {grid} when it is turned, got one that does not")
    low = [max(int(np.floor(m - r)) - 1, 0) for m, r in zip(middle, reach, strict=True)]
    high = [min(int(np.ceil(m + r)) + 2, size) for m, r, size in zip(middle, reach, grid.shape, strict=True)]
    taps = turn_taps(grid.shape, yaw, centre=middle, window=(slice(low[0], high[0]), slice(low[1], high[1])))
    covered = np.where(heights[taps.rows, taps.columns] > 0, taps.weights, np.float32(0))
    return taps, covered, covered.sum(axis=0)


def _thickness(
    heights: NDArray[np.float32], taps: Taps, covered: NDArray[np.float32], share: NDArray[np.float32]
) -> NDArray[np.float32]:
    total = (covered * heights[taps.rows, taps.columns]).sum(axis=0)
    return np.where(share >= np.float32(0.5), total / np.maximum(share, np.float32(0.5)), np.float32(0))
