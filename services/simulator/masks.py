"""What is seen from above once an item lies: the material of the topmost thing."""

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import KDTree

from common.domain.bodies import Bodies, Box
from common.tasks.plating import render_scene
from services.simulator.placement import Placed, Placement


def boxes_after(placement: Placement, placed: Placed, *, world: int = 0) -> tuple[Box, ...]:
    """Return the boxes where a placement has left them."""
    first = int(placement.item is not None)
    poses = zip(placed.outcome.positions[world, first:], placed.outcome.orientations[world, first:], strict=True)
    return tuple(
        Box(box.size, position.astype(np.float64), orientation.astype(np.float64), box.material)
        for box, (position, orientation) in zip(placement.boxes, poses, strict=True)
    )


def materials_after(placement: Placement, placed: Placed, *, world: int = 0) -> NDArray[np.float32]:
    """Return density, Young's modulus and Poisson's ratio of what covers most of each cell ``(3, H, W)``; 0 on plate.

    A cell that shows the item has the material of the item's pixel that lies nearest below its centre.
    """
    grid = placement.state.grid
    boxes = boxes_after(placement, placed, world=world)
    materials = np.array(render_scene(grid, Bodies(placement.plate, boxes)).materials)
    rows, columns = np.nonzero(placed.covered[world] >= 0.5)
    if len(rows):
        centres = np.stack([grid.x[columns], grid.y[rows]], axis=1)
        nearest = KDTree(placed.pixels[world, :, :2]).query(centres)[1]
        pixel_rows, pixel_columns = np.nonzero(placement.outline.covered)
        materials[:, rows, columns] = placement.outline.materials[:, pixel_rows[nearest], pixel_columns[nearest]]
    return materials
