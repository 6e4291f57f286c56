"""Plating: place an item on a plate with fries so that the scene looks like a target (the paper's task)."""

import numpy as np
from numpy.typing import NDArray

from common.domain.bodies import Bodies, Plate
from common.domain.grid import Grid
from common.domain.scene import Scene, State
from common.domain.task import Task

FLAT_RADIUS, RIM_RADIUS, RIM_HEIGHT = 0.080, 0.120, 0.020
BEAD_RADIUS = 0.004
TABLE_HEIGHT = -0.005


class Plating(Task):
    """The item's centre (x, y) is chosen anywhere over the plate, 2 cm inside the grid's edge at most."""

    name = "plating"
    trusted = "simulator"

    def bounds(self, state: State) -> NDArray[np.float64]:
        """Return the square of centres within 8 cm of the plate's centre, or what the grid leaves of it [m]."""
        half_x, half_y = state.grid.half_extent
        return np.array(
            [
                [-min(0.08, half_x - 0.02), min(0.08, half_x - 0.02)],
                [-min(0.08, half_y - 0.02), min(0.08, half_y - 0.02)],
            ]
        )


def dinner_plate() -> Plate:
    """Return the default plate: flat to 8 cm, a rim 2 cm high at 12 cm with a round bead, the table around it."""
    rise = np.linspace(0, 1, 17)[1:]
    slope_radii = FLAT_RADIUS + (RIM_RADIUS - FLAT_RADIUS) * rise
    slope_heights = RIM_HEIGHT * rise**2 * (3 - 2 * rise)
    angle = np.linspace(0, np.pi / 2, 9)[1:]
    bead_radii = RIM_RADIUS + BEAD_RADIUS * np.sin(angle)
    bead_heights = RIM_HEIGHT - BEAD_RADIUS + BEAD_RADIUS * np.cos(angle)
    radii = np.concatenate([[0.0, FLAT_RADIUS], slope_radii, bead_radii, [RIM_RADIUS + BEAD_RADIUS + 1e-3]])
    heights = np.concatenate([[0.0, 0.0], slope_heights, bead_heights, [TABLE_HEIGHT]])
    return Plate(radii, heights)


def render_scene(grid: Grid, bodies: Bodies) -> Scene:
    """Draw plate and boxes from above as heightmap and material masks of the topmost thing."""
    plate = bodies.plate or dinner_plate()
    heights = plate.heightmap(grid)
    materials = np.zeros((3, *grid.shape))
    for box in bodies.boxes:
        top = box.top(grid.x[None, :], grid.y[:, None])
        visible = top > heights
        heights = np.where(visible, top, heights)
        material = (box.material.density, box.material.youngs_modulus, box.material.poisson_ratio)
        for channel, value in zip(materials, material, strict=True):
            channel[visible] = value
    return Scene(grid, heights.astype(np.float32), materials.astype(np.float32), bodies)
