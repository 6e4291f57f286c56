"""Where the bottom of an item that bends would lie: the lowest surface above the scene that bends no more than it does.

A plate of stiffness D under its own weight sags over a span like a parabola. So the surface is made of paraboloids: it
is the scene, closed by a paraboloid (Serra 1982, grey-scale closing), and only what is below the item carries it.
"""

import numpy as np
from numpy.typing import NDArray

from common.domain.grid import Floats

GRAVITY = 9.81


def bending_length(modulus: float, density: float, thickness: float) -> float:
    """Return the span ``(E h^2 / (12 rho g))^(1/3)`` [m] over which an item carries itself.

    Args:
        modulus: Young's modulus [Pa].
        density: Density [kg/m3].
        thickness: Thickness [m].
    """
    return float(np.cbrt(modulus * thickness**2 / (12 * density * GRAVITY)))


def draped(scene: Floats, outline: NDArray[np.bool_], curvature: float) -> NDArray[np.float32]:
    """Return the lowest surface above the scene inside the outline to which paraboloids ``c r^2`` fit from above.

    ``B(x) = min_y [max_z (scene(z) - c |y - z|^2) + c |x - y|^2]``, z inside the outline; outside it is the scene.

    Args:
        scene: Heightmap ``(H, W)``.
        outline: Where the item is ``(H, W)``.
        curvature: The paraboloids' coefficient c [heightmap's unit a cell^2].
    """
    surface = np.array(scene, dtype=np.float32)
    rows, columns = np.nonzero(outline)
    if not len(rows):
        return surface
    box = slice(rows.min(), rows.max() + 1), slice(columns.min(), columns.max() + 1)
    inside = outline[box]
    down, across = (_parabola(length, curvature) for length in inside.shape)
    lowest = np.where(inside, surface[box], np.float32(-np.inf))
    vertices = ((lowest[:, None] - across).max(axis=2).T[:, None] - down).max(axis=2).T
    closed = ((vertices[:, None] + across).min(axis=2).T[:, None] + down).min(axis=2).T
    surface[box] = np.where(inside, closed, surface[box])
    return surface


def _parabola(length: int, curvature: float) -> NDArray[np.float32]:
    places = np.arange(length)
    return (curvature * (places[:, None] - places) ** 2).astype(np.float32)
