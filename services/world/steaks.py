"""The six steaks of the world's stand-in: irregular outlines, uneven thickness, four soft, two rigid T-bones."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import distance_transform_edt

from common.domain.bodies import Material
from common.domain.grid import Grid
from common.domain.scene import Item
from common.tasks.plating_items import Outline, TwoLobes, Wavy, draw_item


@dataclass(frozen=True)
class Steak:
    """One steak.

    Attributes:
        name: What it is called.
        outline: Its outline.
        thickness: Mean thickness [m].
        bumps: Largest deviation from it [m].
        shoulder: Width of the rim along which its edge is rounded off [m].
        material: What it is made of, on average.
        marbling: Largest relative deviation of Young's modulus from the average [-].
        taper: Relative change of the thickness along and across [-].
        seed: Seed of its bumps and its marbling.
    """

    name: str
    outline: Outline
    thickness: float
    bumps: float
    shoulder: float
    material: Material
    marbling: float
    taper: tuple[float, float]
    seed: int

    @property
    def is_rigid(self) -> bool:
        """Whether it is one rigid body."""
        return self.material.youngs_modulus >= 1e8


STEAKS = (
    Steak("rump", Wavy(0.128, 0.088, (0.05, -0.04, 0.02), (0.3, 1.1, 2.0)), 0.0185, 0.0015, 0.006,
          Material(1060, 2.6e4, 0.42), 0.35, (0.06, -0.03), 11),
    Steak("flank", Wavy(0.142, 0.070, (-0.04, 0.05, 0.03), (1.4, 0.2, 0.7)), 0.0140, 0.0012, 0.005,
          Material(1045, 4.5e4, 0.40), 0.30, (-0.08, 0.02), 12),
    Steak("sirloin", Wavy(0.118, 0.096, (0.07, 0.03, -0.02), (2.1, 0.9, 0.1)), 0.0220, 0.0020, 0.007,
          Material(1070, 1.6e4, 0.44), 0.40, (0.03, 0.07), 13),
    Steak("hanger", Wavy(0.105, 0.074, (-0.06, -0.05, 0.03), (0.6, 2.4, 1.3)), 0.0165, 0.0015, 0.006,
          Material(1055, 3.4e4, 0.41), 0.35, (0.05, 0.05), 14),
    Steak("t-bone", TwoLobes(0.135, 0.088, 0.38), 0.0200, 0.0012, 0.005,
          Material(1080, 4e8, 0.30), 0.0, (0.05, 0.0), 15),
    Steak("porterhouse", TwoLobes(0.126, 0.098, 0.45), 0.0235, 0.0015, 0.005,
          Material(1080, 6e8, 0.30), 0.0, (-0.04, 0.04), 16),
)  # fmt: skip


def draw_steak(steak: Steak, grid: Grid, *, yaw: float) -> Item:
    """Draw a steak as the gripper holds it, its centre of area at the grid's centre, turned by ``yaw`` [rad]."""
    plain = draw_item(
        grid, steak.outline, thickness=steak.thickness, material=steak.material, angle=yaw, taper=steak.taper
    )
    cos, sin = np.cos(yaw), np.sin(yaw)
    u, v = cos * grid.x[None, :] + sin * grid.y[:, None], cos * grid.y[:, None] - sin * grid.x[None, :]
    inside = plain.outline
    depth = np.asarray(distance_transform_edt(inside)) * grid.cell
    shoulder = np.clip(depth / steak.shoulder, 0, 1)
    rounded = 0.45 + 0.55 * np.sqrt(np.clip(1 - (1 - shoulder) ** 2, 0, 1))
    heights = (plain.heights + steak.bumps * _waves(u, v, steak.seed)) * rounded
    materials = plain.materials.copy()
    materials[1] *= 1 + steak.marbling * _waves(u, v, steak.seed + 100)
    return Item(np.where(inside, heights, 0).astype(np.float32), np.where(inside, materials, 0).astype(np.float32))


def _waves(u: NDArray[np.float64], v: NDArray[np.float64], seed: int) -> NDArray[np.float64]:
    """Return a smooth random field in [-1, 1], of waves 4 to 9 cm long, fixed to the steak."""
    rng = np.random.default_rng(seed)
    field = np.zeros(np.broadcast_shapes(u.shape, v.shape))
    for _ in range(6):
        length, angle, phase = rng.uniform(0.04, 0.09), rng.uniform(0, 2 * np.pi), rng.uniform(0, 2 * np.pi)
        field += np.cos(2 * np.pi * (np.cos(angle) * u + np.sin(angle) * v) / length + phase)
    return field / 6
