"""How the outcome of a placement moves with the action: the settled surface goes with the item."""

from typing import Any

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view
from numpy.typing import NDArray

from common.domain.grid import Floats
from common.domain.scene import State
from common.domain.transport import Transport, Window

FULL_THICKNESS = 0.010
"""Where the item is this thick the surface is all its own [m]."""


class PlatingTransport(Transport):
    """Move the settled surface ``S_k`` of action ``a_k`` with the item.

    ``P(a) = m(a) shift(S_k, a - a_k) + (1 - m(a) - u) S_k + u I_0`` with ``m(a) = clip(shift(I_obj, a) / 10 mm, 0, 1)``
    and ``u = max(m(a_k) - m(a), 0)``, where the item no longer is.

    Args:
        state: Scene and item.
        action: The action ``a_k`` ``(2,)`` [m].
        outcome: Its outcome ``S_k`` ``(H, W)`` [m].
        carried: What is shifted instead of ``S_k`` ``(H, W)`` [m]: ``S_k`` turned about ``a_k``.
        before: The item's heights in ``m(a_k)`` ``(H, W)`` [m], where it was turned before it was placed.
        after: The same in ``m(a)``.
    """

    def __init__(
        self,
        state: State,
        action: NDArray[np.float64],
        outcome: Floats,
        *,
        carried: Floats | None = None,
        before: Floats | None = None,
        after: Floats | None = None,
    ) -> None:
        self.outcome = np.asarray(outcome, dtype=np.float32)
        self._cell = state.grid.cell
        self._action = np.asarray(action, dtype=np.float64)
        self._scene = state.scene.heights
        self._item = state.item.heights if after is None else np.asarray(after, dtype=np.float32)
        self._carried = self.outcome if carried is None else np.asarray(carried, dtype=np.float32)
        self._before = state.item.heights if before is None else np.asarray(before, dtype=np.float32)
        self._corners = _corners(self._item + self._before)

    def window(self, actions: NDArray[np.float64]) -> Window:
        """Return the cells that the item may reach."""
        places = np.vstack([actions, self._action])[:, ::-1] / self._cell
        low = np.floor(places.min(axis=0)).astype(int) + self._corners[0]
        high = np.ceil(places.max(axis=0)).astype(int) + self._corners[1] + 1
        low, high = np.maximum(low, 0), np.minimum(high, self.outcome.shape)
        return slice(int(low[0]), int(high[0])), slice(int(low[1]), int(high[1]))

    def patches(
        self, actions: NDArray[np.float64], window: Window, shared: dict[Any, Any] | None = None
    ) -> NDArray[np.float32]:
        """Return the new surface in a window ``(B, h, w)`` [m]."""
        places, place = actions[:, ::-1] / self._cell, self._action[None, ::-1] / self._cell
        shared = {} if shared is None else shared
        if "mask" not in shared:
            shared["mask"] = _mask(self._item, places, window)
        mask, before = shared["mask"], _mask(self._before, place, window)
        surface, scene = self.outcome[window], self._scene[window]
        patches = _moved(self._carried, places - place, window)
        patches -= surface
        patches *= mask
        patches += surface
        patches += np.maximum(before - mask, 0) * (scene - surface)
        return patches

    def distances(self, actions: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return how far from ``a_k`` the actions are ``(B,)`` [m]."""
        return np.linalg.norm(actions - self._action, axis=1)

    def aligned(self) -> NDArray[np.float32]:
        """Return the settled surface at the item's cells ``(p,)`` [m], as if it lay at the grid's centre."""
        rows, columns = _corners(self._item).T
        window = slice(int(rows[0]), int(rows[1])), slice(int(columns[0]), int(columns[1]))
        moved = _moved(self._carried, -self._action[None, ::-1] / self._cell, window)[0]
        return moved[self._item[window] > 0]


def _corners(item: NDArray[np.float32]) -> NDArray[np.intp]:
    """Return the first row and column that the item covers, and those behind its last ``(2, 2)``."""
    rows, columns = np.nonzero(item)
    return np.array([[rows.min(), columns.min()], [rows.max() + 1, columns.max() + 1]])


def _mask(item: NDArray[np.float32], cells: NDArray[np.float64], window: Window) -> NDArray[np.float32]:
    """Return ``m`` of an item shifted by rows and columns ``(B, 2)``, in a window ``(B, h, w)``."""
    return np.clip(_moved(item, cells, window) / np.float32(FULL_THICKNESS), 0, 1)


def _moved(image: NDArray[np.float32], cells: NDArray[np.float64], window: Window) -> NDArray[np.float32]:
    """Return a window of the image shifted by rows and columns ``(B, 2)``, bilinear, 0 flowing in ``(B, h, w)``."""
    whole = np.floor(cells).astype(int)
    part = (cells - whole).astype(np.float32)[:, :, None, None]
    height, width = window[0].stop - window[0].start, window[1].stop - window[1].start
    first = np.array([window[0].start, window[1].start]) - whole - 1
    last = first + np.array([height + 1, width + 1])
    before = np.maximum(-first.min(axis=0), 0)
    after = np.maximum(last.max(axis=0) - image.shape, 0)
    padded = np.pad(image, list(zip(before, after, strict=True)))
    views = sliding_window_view(padded, (height + 1, width + 1))
    taps = views[first[:, 0] + before[0], first[:, 1] + before[1]]
    rows = taps[:, 1:] + part[:, 0] * (taps[:, :-1] - taps[:, 1:])
    return (rows[:, :, 1:] + part[:, 1] * (rows[:, :, :-1] - rows[:, :, 1:])).astype(np.float32, copy=False)
