"""Where the plate is in a depth image: a calibration that is a little wrong is put right by the plate itself."""

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import least_squares

from common.domain.bodies import Plate
from common.domain.camera import Camera
from common.domain.errors import RequestError
from common.domain.grid import Floats
from pipelines.data.depth import surface_points

REACH = 0.135
"""Points up to this far from the plate's centre take part [m]."""
FLAT = 0.05
"""The plate's flat is at least this large; its height is 0 [m]."""
RING = 0.0015
"""Width of the rings whose median heights are the plate's profile [m]."""
POINTS = 6000
OUTLIER = 0.0015
"""Residual beyond which a point counts less and less [m]."""
FARTHEST = (0.03, 0.02, 0.1)
"""Largest correction: shift along x and y [m], along z [m], and tilt [rad]."""


def align(depth: Floats, camera: Camera, known: Plate) -> tuple[Camera, Plate]:
    """Return the camera with its pose put right, and the plate's profile, from an image of the empty plate.

    Shift and tilt are those for which the points form a surface of revolution about z: its profile begins as that of a
    known plate, and is then the median height of rings, its flat at height 0.

    Args:
        depth: Image of the empty plate ``(h, w)`` [m].
        camera: The camera as it was calibrated.
        known: A plate that is something like this one.

    Raises:
        RequestError: No plate is there, or it is too far from where the calibration says.
    """
    points = surface_points(depth, camera)
    points = points[np.hypot(points[:, 0], points[:, 1]) < REACH]
    if len(points) < POINTS // 10:
        raise RequestError(f"plate: expected at least {POINTS // 10} pixels of it in the image, got {len(points)}")
    some = points[np.linspace(0, len(points) - 1, min(POINTS, len(points))).astype(int)]
    radii, heights = known.radii, known.heights
    found = np.zeros(5)
    for _ in range(3):
        found = least_squares(
            _misfit,
            found,
            args=(some, radii, heights),
            loss="soft_l1",
            f_scale=OUTLIER,
            x_scale=(1e-3,) * 3 + (1e-2,) * 2,
        ).x
        radii, heights = _profile(_moved(points, found))
    shift, rise, tilt = np.hypot(found[0], found[1]), abs(found[2]), np.abs(found[3:]).max()
    if (np.array([shift, rise, tilt]) > FARTHEST).any():
        raise RequestError(
            f"plate: expected it within {1e3 * FARTHEST[0]:g} mm of where the pose says, {1e3 * FARTHEST[1]:g} mm in "
            f"height and {FARTHEST[2]:g} rad, got {1e3 * shift:.0f} mm, {1e3 * rise:.0f} mm and {tilt:.2f} rad"
        )
    turn = _turn(found)
    corrected = replace(
        camera, rotation=turn @ camera.rotation, position=turn @ camera.position - found[:3] - [0, 0, heights[0]]
    )
    return corrected, Plate(radii, heights - heights[0])


def _turn(found: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the rotation about x and then y ``(3, 3)``."""
    (cos_x, cos_y), (sin_x, sin_y) = np.cos(found[3:]), np.sin(found[3:])
    about_x = np.array([[1, 0, 0], [0, cos_x, -sin_x], [0, sin_x, cos_x]])
    about_y = np.array([[cos_y, 0, sin_y], [0, 1, 0], [-sin_y, 0, cos_y]])
    return about_y @ about_x


def _moved(points: NDArray[np.float64], found: NDArray[np.float64]) -> NDArray[np.float64]:
    return points @ _turn(found).T - found[:3]


def _misfit(
    found: NDArray[np.float64], points: NDArray[np.float64], radii: Floats, heights: Floats
) -> NDArray[np.float64]:
    moved = _moved(points, found)
    return moved[:, 2] - np.interp(np.hypot(moved[:, 0], moved[:, 1]), radii, heights)


def _profile(points: NDArray[np.float64]) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return radii and median heights of the rings, the flat as one level."""
    radius = np.hypot(points[:, 0], points[:, 1])
    flat = float(np.median(points[radius < FLAT, 2]))
    ring = (radius / RING).astype(int)
    rings = [index for index in range(int(FLAT / RING), int(REACH / RING)) if (ring == index).any()]
    heights = [float(np.median(points[ring == index, 2])) for index in rings]
    return np.array([0.0, *((index + 0.5) * RING for index in rings)]), np.array([flat, *heights])
