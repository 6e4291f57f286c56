"""The parameters of an action, and how far apart two values of one are."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray


@dataclass(frozen=True)
class Parameter:
    """One parameter of an action.

    Attributes:
        name: Its word on cards.
        unit: SI unit, ``m`` or ``rad``.
        period: Values that differ by this are the same; None if no two are.
    """

    name: str
    unit: str
    period: float | None = None


X, Y = Parameter("x", "m"), Parameter("y", "m")
YAW = Parameter("yaw", "rad", period=2 * np.pi)
"""A turn about the item's centre, counter-clockwise seen from above: from x to y."""


def differences(
    parameters: Sequence[Parameter], actions: NDArray[np.float64], others: NDArray[np.float64]
) -> NDArray[np.float64]:
    """Return ``actions - others`` ``(..., n)``, the short way round where a parameter has a period."""
    gaps = np.asarray(actions, dtype=np.float64) - others
    for index, parameter in enumerate(parameters):
        if parameter.period is not None:
            gaps[..., index] = (gaps[..., index] + parameter.period / 2) % parameter.period - parameter.period / 2
    return gaps
