"""A depth camera that sees a known scene: rays marched until they meet the surface."""

from dataclasses import dataclass

import numpy as np

from common.domain.bodies import Box, Material
from common.domain.camera import Camera
from common.tasks.plating import dinner_plate

FINE = 0.0005
HALF = 0.20
SIZE = (300, 400)
FRIES = tuple(
    Box(
        np.array([0.06, 0.010, 0.010]),
        np.array([x, y, 0.005]),
        np.array([0, 0, np.sin(yaw / 2), np.cos(yaw / 2)]),
        Material(550, 1e6, 0.3),
    )
    for x, y, yaw in ((-0.03, 0.02, 0.4), (-0.04, -0.03, 1.9), (0.045, 0.045, 2.6))
)
THICKNESS = 0.018


@dataclass(frozen=True)
class Surface:
    """Heights over a fine square lattice [m]."""

    heights: np.ndarray

    def at(self, x, y):
        columns = np.rint((np.asarray(x) + HALF) / FINE).astype(int).clip(0, self.heights.shape[1] - 1)
        rows = np.rint((np.asarray(y) + HALF) / FINE).astype(int).clip(0, self.heights.shape[0] - 1)
        return self.heights[rows, columns]

    def means(self, grid):
        """Return the mean height over each cell ``(H, W)``."""
        part = (np.arange(6) - 2.5) / 6 * grid.cell
        x = (grid.x[:, None] + part).ravel()
        y = (grid.y[:, None] + part).ravel()
        fine = self.at(x[None, :], y[:, None])
        return fine.reshape(grid.rows, 6, grid.columns, 6).mean(axis=(1, 3))


def surface(*, fries=(), item=None):
    """Return plate, fries and an elliptic slab of `THICKNESS` with axes 10 x 7 cm centred at ``item``."""
    line = np.arange(-HALF, HALF + FINE / 2, FINE)
    x, y = line[None, :], line[:, None]
    heights = dinner_plate().height(np.hypot(x, y))
    for box in fries:
        heights = np.maximum(heights, box.top(x, y))
    if item is not None:
        inside = np.hypot((x - item[0]) / 0.05, (y - item[1]) / 0.035) <= 1
        heights = np.where(inside, heights + THICKNESS, heights)
    return Surface(heights)


def camera(*, tilt=0.35, distance=0.6, focal=420.0):
    """Return a camera that looks at the plate's centre, tilted from the vertical [rad]."""
    forward = np.array([0.0, np.sin(tilt), -np.cos(tilt)])
    right = np.array([1.0, 0.0, 0.0])
    rotation = np.stack([right, np.cross(forward, right), forward], axis=1)
    return Camera(focal, focal, (SIZE[1] - 1) / 2, (SIZE[0] - 1) / 2, rotation, -distance * forward)


def look(scene, eye):
    """Return the depth image ``(h, w)`` [m] of a surface: steps of 1 mm in height, then halved ten times."""
    rows, columns = np.indices(SIZE)
    rays = np.stack([(columns - eye.cx) / eye.fx, (rows - eye.cy) / eye.fy, np.ones(SIZE)], axis=-1) @ eye.rotation.T
    step = 0.001 / -rays[..., 2]
    low = (eye.position[2] - 0.06) / -rays[..., 2]
    met = np.zeros(SIZE, dtype=bool)
    for _ in range(70):
        point = eye.position + low[..., None] * rays
        met |= point[..., 2] <= scene.at(point[..., 0], point[..., 1])
        low = np.where(met, low, low + step)
    near, far = low - step, low
    for _ in range(10):
        middle = (near + far) / 2
        point = eye.position + middle[..., None] * rays
        below = point[..., 2] <= scene.at(point[..., 0], point[..., 1])
        near, far = np.where(below, near, middle), np.where(below, middle, far)
    return far
