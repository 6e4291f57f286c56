"""How the outcome of a placement moves with the action: the settled surface goes with the item."""

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view
from numpy.typing import NDArray

from common.domain.grid import Floats
from common.domain.scene import State
from common.domain.transport import Transport

FULL_THICKNESS = 0.010
"""Where the item is this thick the surface is all its own [m]."""
NOISE, NEAR, FAR = 2.5e-5, 4.5e-5, 0.027
"""Standard deviation of a transported reward: at no distance, added up to `NEAR_DISTANCE` [m], per distance [-]."""
NEAR_DISTANCE = 1e-3


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
        self._cell = state.grid.cell
        self._action = np.asarray(action, dtype=np.float64)
        self._outcome = np.asarray(outcome, dtype=np.float32)
        self._scene = state.scene.heights
        self._item = state.item.heights if after is None else np.asarray(after, dtype=np.float32)
        self._carried = self._outcome if carried is None else np.asarray(carried, dtype=np.float32)
        self._before = state.item.heights if before is None else np.asarray(before, dtype=np.float32)
        rows, columns = np.nonzero(self._item + self._before)
        self._corners = np.array([[rows.min(), columns.min()], [rows.max() + 1, columns.max() + 1]])

    def outcomes(self, actions: NDArray[np.float64]) -> NDArray[np.float32]:
        """Return the heightmaps ``(B, H, W)`` [m]."""
        window, patches = self._patches(actions)
        moved = np.repeat(self._outcome[None], len(actions), axis=0)
        moved[:, window[0], window[1]] = patches
        return moved

    def errors(self, actions: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return ``sqrt(NOISE^2 + (NEAR min(d / NEAR_DISTANCE, 1))^2 + (FAR d)^2)`` for a distance d to ``a_k`` [m]."""
        return errors_at(np.linalg.norm(actions - self._action, axis=1))

    def rewards(self, actions: NDArray[np.float64], target: Floats) -> NDArray[np.float64]:
        """Return the rewards ``(B,)`` [m]; only the cells that the item may reach are computed again."""
        window, patches = self._patches(actions)
        wanted = np.asarray(target, dtype=np.float32)
        still = np.abs(self._outcome - wanted)
        rest = float(still.sum(dtype=np.float64) - still[window].sum(dtype=np.float64))
        patches -= wanted[window]
        np.abs(patches, out=patches)
        return -(rest + patches.sum(axis=(1, 2), dtype=np.float64)) / wanted.size

    def _patches(self, actions: NDArray[np.float64]) -> tuple[tuple[slice, slice], NDArray[np.float32]]:
        """Return the window that the item may reach, and the new surface in it ``(B, h, w)``."""
        places = np.vstack([actions, self._action])[:, ::-1] / self._cell
        low = np.floor(places.min(axis=0)).astype(int) + self._corners[0]
        high = np.ceil(places.max(axis=0)).astype(int) + self._corners[1] + 1
        low, high = np.maximum(low, 0), np.minimum(high, self._outcome.shape)
        window = slice(int(low[0]), int(high[0])), slice(int(low[1]), int(high[1]))
        mask, before = (
            np.clip(_moved(item, at, window) / np.float32(FULL_THICKNESS), 0, 1)
            for item, at in ((self._item, places[:-1]), (self._before, places[-1:]))
        )
        surface, scene = self._outcome[window], self._scene[window]
        patches = _moved(self._carried, places[:-1] - places[-1], window)
        patches -= surface
        patches *= mask
        patches += surface
        patches += np.maximum(before - mask, 0) * (scene - surface)
        return window, patches


def errors_at(distance: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the errors of rewards that are transported over a distance ``(B,)`` [m]."""
    return np.sqrt(NOISE**2 + (NEAR * np.minimum(distance / NEAR_DISTANCE, 1)) ** 2 + (FAR * distance) ** 2)


def _moved(image: NDArray[np.float32], cells: NDArray[np.float64], window: tuple[slice, slice]) -> NDArray[np.float32]:
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
