"""Where an item that does not bend would come to rest on a scene that does not give way.

It minimises the height of its centre of mass while no point of its flat bottom goes below the scene: a linear
programme in the three numbers of a plane. Its dual is the triangle of points of the scene, around the centre of mass,
that carries the highest plane; the simplex method finds it by exchanging one corner at a time.
"""

import numpy as np
from numpy.typing import NDArray

from common.domain.grid import Floats

EXCHANGES = 100
"""Most exchanges; 5 to 20 are usual."""

TOLERANCE = 1e-7
"""How far the scene may be above the plane [m]."""

FAR, DEEP = 1e3, -1e3
"""The first triangle: its corners' distance from the centre of mass [cells] and height [m]."""

Point = tuple[float, float, float]
"""Three coordinates of a point, or three numbers of a plane."""


def resting_plane(scene: Floats, outline: NDArray[np.bool_], weight: Floats) -> Point:
    """Return slopes along x and y [m a cell] and offset [m] of an unbending item's flat bottom at rest on the scene.

    The plane's height is ``slope_x * column + slope_y * row + offset``. It is 0 for an item that has no cell here.

    Args:
        scene: Heightmap ``(H, W)`` [m].
        outline: Where the item is ``(H, W)``.
        weight: Its mass at each cell, in any unit ``(H, W)``; positive inside the outline.
    """
    rows, columns = np.nonzero(outline)
    if not len(rows):
        return 0.0, 0.0, 0.0
    x, y = columns.astype(np.float64), rows.astype(np.float64)
    z, mass = scene[outline].astype(np.float64), weight[outline].astype(np.float64)
    return _lowest_plane(x, y, z, float((mass * x).sum() / mass.sum()), float((mass * y).sum() / mass.sum()))


def _lowest_plane(
    x: NDArray[np.float64], y: NDArray[np.float64], z: NDArray[np.float64], centre_x: float, centre_y: float
) -> Point:
    """Return the plane over all points ``(P,)`` that is the lowest at the centre."""
    angles = (0.1, 2.2, 4.3)
    corners: list[Point] = [(centre_x + FAR * np.cos(turn), centre_y + FAR * np.sin(turn), DEEP) for turn in angles]
    shares = _shares(corners, centre_x, centre_y)
    for _ in range(EXCHANGES):
        slope_x, slope_y, offset = _plane(corners)
        above = slope_x * x + slope_y * y + (offset - z)
        lowest = int(above.argmin())
        if above[lowest] > -TOLERANCE:
            break
        new = float(x[lowest]), float(y[lowest]), float(z[lowest])
        of_new = _shares(corners, new[0], new[1])
        leaving = min((k for k in range(3) if of_new[k] > 0), key=lambda k: shares[k] / of_new[k])
        exchanged = [new if k == leaving else corner for k, corner in enumerate(corners)]
        if abs(_area(exchanged)) < 1e-9:
            break
        corners, shares = exchanged, [max(share, 0.0) for share in _shares(exchanged, centre_x, centre_y)]
    return _plane(corners)


def _plane(corners: list[Point]) -> Point:
    """Return slopes and offset of the plane through three points."""
    (x, y, z), *others = corners
    (ux, uy, uz), (vx, vy, vz) = ((b[0] - x, b[1] - y, b[2] - z) for b in others)
    area = ux * vy - vx * uy
    slope_x, slope_y = (uz * vy - vz * uy) / area, (ux * vz - vx * uz) / area
    return slope_x, slope_y, z - slope_x * x - slope_y * y


def _shares(corners: list[Point], x: float, y: float) -> list[float]:
    """Return the barycentric coordinates of a point in the triangle of the corners."""
    area = _area(corners)
    return [_area([(x, y, 0.0) if k == i else corner for k, corner in enumerate(corners)]) / area for i in range(3)]


def _area(corners: list[Point]) -> float:
    (ax, ay, _), (bx, by, _), (cx, cy, _) = corners
    return (bx - ax) * (cy - ay) - (cx - ax) * (by - ay)
