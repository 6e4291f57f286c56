"""What is to be optimised."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from common.domain.errors import RequestError
from common.domain.grid import check_heightmap
from common.domain.scene import State
from common.domain.task import Task

MOST_PARAMETERS = 6


@dataclass(frozen=True)
class Problem:
    """Find the action within the bounds after which the state looks most like the target.

    Attributes:
        task: What an action means and how good its outcome is.
        state: Scene and item.
        target: Heightmap ``(H, W)`` [m], ``s_g`` in the paper.
        bounds: Smallest and largest value of each action parameter ``(n, 2)``; the task's own if None.

    Raises:
        RequestError: The target does not fit the state's grid or is not finite, or the bounds are empty, not finite,
            of the wrong shape or outside the task's.
    """

    task: Task
    state: State
    target: NDArray[np.float32]
    bounds: NDArray[np.float64] | None = None

    def __post_init__(self) -> None:
        object.__setattr__(self, "target", check_heightmap("target", self.target, self.state.grid))
        object.__setattr__(self, "bounds", self._checked_bounds())

    @property
    def limits(self) -> NDArray[np.float64]:
        """The bounds, known to be there ``(n, 2)``."""
        assert self.bounds is not None
        return self.bounds

    def _checked_bounds(self) -> NDArray[np.float64]:
        widest = self.task.bounds(self.state)
        bounds = check_bounds(widest if self.bounds is None else self.bounds)
        if bounds.shape != widest.shape:
            raise RequestError(f"bounds: expected {len(widest)} action parameters, got {len(bounds)}")
        if (bounds[:, 0] < widest[:, 0] - 1e-9).any() or (bounds[:, 1] > widest[:, 1] + 1e-9).any():
            raise RequestError(f"bounds: expected them within {widest.tolist()}, got {bounds.tolist()}")
        return bounds


def check_bounds(bounds: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return bounds as a read-only float64 ``(n, 2)`` array that is finite and not empty, or raise `RequestError`."""
    checked = np.array(bounds, dtype=np.float64)
    if checked.ndim != 2 or checked.shape[1] != 2 or not 1 <= len(checked) <= MOST_PARAMETERS:
        raise RequestError(f"bounds: expected shape (n, 2) with n from 1 to {MOST_PARAMETERS}, got {checked.shape}")
    if not np.isfinite(checked).all():
        raise RequestError(f"bounds: expected finite numbers, got {checked.tolist()}")
    if (checked[:, 0] >= checked[:, 1]).any():
        raise RequestError(f"bounds: expected each smallest value below its largest, got {checked.tolist()}")
    checked.flags.writeable = False
    return checked
