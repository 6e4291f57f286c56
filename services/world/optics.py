"""What a depth camera sees of a surface, and what is wrong with it: noise, holes, bleeding edges, a wrong pose."""

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import gaussian_filter, maximum_filter, minimum_filter

from common.domain.camera import Camera

Surface = Callable[[NDArray[np.float64], NDArray[np.float64]], NDArray[np.float64]]
"""Height over points x, y, all of one shape [m]."""

UNIT = 1e-4
"""What one unit of a depth image means [m]."""
EDGE = 0.004
"""Depths of neighbouring pixels that differ by more than this have an edge between them [m]."""
HIGHEST = 0.07
"""Nothing on the plate is higher [m]."""


@dataclass(frozen=True)
class Optics:
    """A depth camera and its faults.

    Attributes:
        height: Distance from the plate's centre along the line of sight [m].
        tilt: Angle between that line and the vertical [rad].
        focal: Focal length [pixel].
        shape: Rows and columns of an image.
        noise: Standard deviation of a pixel's depth [m].
        drift: Standard deviation of errors that neighbouring pixels share [m].
        reach: How far they share it [pixel].
        speckle: Share of pixels without a depth [-].
        lost_edges: Share of pixels at an edge without a depth [-].
        bleeding: Share of the other pixels at an edge that show something between the two surfaces [-].
        blobs: Holes in an image: their number, and smallest and largest radius [pixel].
        offset: Error of the camera's position in the pose that it tells ``(3,)`` [m].
        turn: Error of its rotation, about the plate's x, y and z ``(3,)`` [rad].
    """

    height: float = 0.50
    tilt: float = 0.12
    focal: float = 440.0
    shape: tuple[int, int] = (320, 424)
    noise: float = 7e-4
    drift: float = 2e-4
    reach: float = 6.0
    speckle: float = 0.01
    lost_edges: float = 0.35
    bleeding: float = 0.40
    blobs: tuple[int, int, int] = (5, 1, 4)
    offset: tuple[float, float, float] = (0.0011, -0.0008, 0.0015)
    turn: tuple[float, float, float] = (0.003, -0.002, 0.004)

    @property
    def camera(self) -> Camera:
        """The camera as it is."""
        forward = np.array([0.0, np.sin(self.tilt), -np.cos(self.tilt)])
        right = np.array([1.0, 0.0, 0.0])
        rotation = np.stack([right, np.cross(forward, right), forward], axis=1)
        rows, columns = self.shape
        return Camera(self.focal, self.focal, (columns - 1) / 2, (rows - 1) / 2, rotation, -self.height * forward)

    @property
    def calibrated(self) -> Camera:
        """The camera as its calibration tells it."""
        true, (a, b, c) = self.camera, self.turn
        small = np.array([[0, -c, b], [c, 0, -a], [-b, a, 0]])
        turn = np.linalg.qr(np.eye(3) + small)[0]
        turn *= np.sign(np.diag(turn))
        return replace(true, rotation=turn @ true.rotation, position=true.position + np.array(self.offset))

    def see(self, surface: Surface, rng: np.random.Generator) -> NDArray[np.uint16]:
        """Return the depth image of a surface, in whole `UNIT`; 0 where there is none."""
        depth = _march(surface, self.camera, self.shape)
        near, far = minimum_filter(depth, 3), maximum_filter(depth, 3)
        at_edge, draw = far - near > EDGE, rng.random(self.shape)
        bled = near + rng.random(self.shape) * (far - near)
        seen = np.where(at_edge & (draw < self.bleeding), bled, depth)
        shared = gaussian_filter(rng.standard_normal(self.shape), self.reach)
        seen = seen + self.drift * shared / shared.std() + self.noise * rng.standard_normal(self.shape)
        lost = (rng.random(self.shape) < self.speckle) | (at_edge & (draw > 1 - self.lost_edges))
        rows, columns = np.indices(self.shape)
        count, smallest, largest = self.blobs
        for _ in range(count):
            row, column = rng.uniform(0, self.shape[0]), rng.uniform(0, self.shape[1])
            lost |= np.hypot(rows - row, columns - column) < rng.uniform(smallest, largest)
        return np.where(lost, 0, np.rint(seen / UNIT)).astype(np.uint16)


def _march(surface: Surface, camera: Camera, shape: tuple[int, int], *, step: float = 0.0015) -> NDArray[np.float64]:
    """Return the depth at which each pixel's ray meets the surface ``(h, w)`` [m]: steps in height, then halvings."""
    rows, columns = np.indices(shape)
    rays = np.stack([(columns - camera.cx) / camera.fx, (rows - camera.cy) / camera.fy, np.ones(shape)], axis=-1)
    rays = rays.reshape(-1, 3) @ camera.rotation.T
    start = (camera.position[2] - HIGHEST) / -rays[:, 2]
    stride = step / -rays[:, 2]
    depth, going = start.copy(), np.arange(len(rays))
    for _ in range(round(0.1 / step)):
        depth[going] += stride[going]
        point = camera.position + depth[going, None] * rays[going]
        going = going[point[:, 2] > surface(point[:, 0], point[:, 1])]
        if not going.size:
            break
    low, high = depth - stride, depth
    for _ in range(6):
        middle = (low + high) / 2
        point = camera.position + middle[:, None] * rays
        below = point[:, 2] <= surface(point[:, 0], point[:, 1])
        low, high = np.where(below, low, middle), np.where(below, middle, high)
    return high.reshape(shape)
