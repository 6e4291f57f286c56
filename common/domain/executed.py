"""Whether what a robot reports of an action that it executed can be true."""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from common.domain.deviation import deviation
from common.domain.errors import RequestError
from common.domain.grid import Floats, check_heightmap
from common.domain.scene import State
from common.domain.task import Task

HIGHEST = 0.5
"""No scene, item or outcome is higher or lower than this: one that is has another unit [m]."""
LEAST_CHANGE = 5e-6
"""An outcome that is nearer to the scene than this, on average, is the scene [m]."""
VOLUME_RATIOS = 0.2, 5.0
"""Between these lies what the outcome adds to the scene, as a multiple of the item's volume.

Simulated placements lie between 0.9 and 2.6: there is air below an item that bridges fries.
"""
BOUND_MARGIN = 1e-6
"""An action that is further outside of the task's bounds than single precision explains is refused."""


def added_volume(state: State, outcome: Floats) -> float:
    """Return what an outcome ``(H, W)`` [m] adds to the scene, what is hidden below the item included [m3]."""
    added = np.asarray(outcome, dtype=np.float64) - state.scene.heights
    return float(added.sum()) * state.grid.cell**2


def item_volume(state: State) -> float:
    """Return the item's volume [m3]."""
    return float(state.item.heights.sum(dtype=np.float64)) * state.grid.cell**2


def check_executed(task: Task, state: State, action: Sequence[float], outcome: Floats) -> NDArray[np.float32]:
    """Return the outcome ``(H, W)`` [m] of an executed action ``(n,)`` as read-only float32, if it is plausible.

    Raises:
        RequestError: The outcome does not fit the grid, a height is not in metres, the action is none of the task's,
            nothing was placed, or what was added cannot be the item.
    """
    checked = check_heightmap("outcome", outcome, state.grid)
    for name, heights in (("scene", state.scene.heights), ("item", state.item.heights), ("outcome", checked)):
        highest = float(np.abs(heights).max())
        if highest > HIGHEST:
            raise RequestError(f"{name}: expected heights within {HIGHEST} m, got {highest:.3g} m: is the unit metres?")
    _check_action(task, state, action)
    change = float(deviation(checked, state.scene.heights))
    if change < LEAST_CHANGE:
        raise RequestError(
            f"outcome: expected a mean difference to the scene of at least {LEAST_CHANGE * 1e6:g} um, "
            f"got {change * 1e6:.3g} um: was nothing placed?"
        )
    ratio, (least, most) = added_volume(state, checked) / item_volume(state), VOLUME_RATIOS
    if not least <= ratio <= most:
        raise RequestError(
            f"outcome: expected {least:g} to {most:g} times the item's volume above the scene, got {ratio:.3g} times "
            f"{item_volume(state) * 1e6:.3g} cm3"
        )
    return checked


def _check_action(task: Task, state: State, action: Sequence[float]) -> None:
    if len(action) != len(task.parameters):
        raise RequestError(f"action: expected {', '.join(task.names)} as {task.name} has it, got {len(action)} numbers")
    for parameter, value, (low, high) in zip(task.parameters, action, task.bounds(state), strict=True):
        if not low - BOUND_MARGIN <= value <= high + BOUND_MARGIN:
            raise RequestError(
                f"action: expected {parameter.name} between {low:g} and {high:g} {parameter.unit}, got {value:g}"
            )
