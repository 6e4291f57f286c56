"""Plating: place an item on a plate with fries so that the scene looks like a target (the paper's task)."""

from types import MappingProxyType

import numpy as np
from numpy.typing import NDArray

from common.domain.bodies import Bodies, Box, Plate
from common.domain.grid import SUBSAMPLES, Floats, Grid
from common.domain.scene import Scene, State
from common.domain.task import Task
from common.domain.transport import Transport
from common.tasks.plating_transport import PlatingTransport

FLAT_RADIUS, RIM_RADIUS, RIM_HEIGHT = 0.080, 0.120, 0.020
BEAD_RADIUS = 0.004
TABLE_HEIGHT = -0.005


class Plating(Task):
    """The item's centre (x, y) is chosen anywhere over the plate, 2 cm inside the grid's edge at most."""

    name = "plating"
    trusted = "simulator"
    levels = MappingProxyType({"simulator_fine": "simulator"})

    def bounds(self, state: State) -> NDArray[np.float64]:
        """Return the square of centres within 8 cm of the plate's centre, or what the grid leaves of it [m]."""
        half_x, half_y = state.grid.half_extent
        return np.array(
            [
                [-min(0.08, half_x - 0.02), min(0.08, half_x - 0.02)],
                [-min(0.08, half_y - 0.02), min(0.08, half_y - 0.02)],
            ]
        )

    def transport(self, state: State, action: NDArray[np.float64], outcome: Floats) -> Transport:
        """Return the settled surface as it moves with the item."""
        return PlatingTransport(state, action, outcome)


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
    """Draw plate and boxes from above: the mean height of every cell, and the material that shows on most of it."""
    plate = bodies.plate or dinner_plate()
    ground = plate.heightmap(grid).astype(np.float64)
    samples = np.repeat(ground[..., None], len(SUBSAMPLES), axis=-1)
    owner = np.full(samples.shape, -1)
    for index, box in enumerate(bodies.boxes):
        rows, columns = _cells_below(grid, box)
        if not len(rows) or not len(columns):
            continue  # beside the grid
        x = grid.x[columns, None] + grid.cell * SUBSAMPLES[:, 0]
        y = grid.y[rows, None] + grid.cell * SUBSAMPLES[:, 1]
        top = box.top(x[None, :, :], y[:, None, :])
        window = np.s_[rows[0] : rows[-1] + 1, columns[0] : columns[-1] + 1]
        visible = top > samples[window]
        samples[window] = np.where(visible, top, samples[window])
        owner[window] = np.where(visible, index, owner[window])
    shares = np.array([(owner == index).mean(axis=-1) for index in range(-1, len(bodies.boxes))])
    topmost = shares.argmax(axis=0)
    table = [(0.0, 0.0, 0.0)] + [
        (box.material.density, box.material.youngs_modulus, box.material.poisson_ratio) for box in bodies.boxes
    ]
    materials = np.moveaxis(np.array(table)[topmost], -1, 0)
    return Scene(grid, samples.mean(axis=-1).astype(np.float32), materials.astype(np.float32), bodies)


def _cells_below(grid: Grid, box: Box) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
    """Return the rows and columns of cells that a box may cover, seen from above."""
    reach = np.abs(box.rotation[:2]) @ (box.size / 2) + grid.cell
    rows = np.flatnonzero(np.abs(grid.y - box.position[1]) < reach[1])
    columns = np.flatnonzero(np.abs(grid.x - box.position[0]) < reach[0])
    return rows, columns
