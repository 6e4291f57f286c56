"""A trial seen by a depth camera as a case: the scene before, the item, the action, the scene after."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from common.domain.bodies import Material
from common.domain.case import Case
from common.domain.errors import RequestError
from common.domain.grid import Floats, Grid
from common.domain.scene import Item, Scene, State
from common.tasks.plating import RIM_RADIUS, dinner_plate
from pipelines.data.depth import Camera, heightmap_from_depth

LEAST_THICKNESS = 0.004
"""What rises above the empty plate by less than this is noise [m]."""


INSIDE_RIM = RIM_RADIUS - 0.005
"""Food is looked for within this distance of the plate's centre: the plate's edge hides what is behind it [m]."""


@dataclass(frozen=True)
class DepthTrial:
    """What the camera saw.

    Attributes:
        before: Depth image of plate and fries ``(h, w)`` [m].
        after: The same with the item placed.
        item: The item alone on the empty plate, its whole outline on the flat.
        plate: The empty plate; None: it is the default one.
        item_material: What the item is made of.
        scene_material: What lies on the plate.
        action: Where the item's centre was placed ``(x, y)`` [m]; None if nobody knows it.
    """

    before: Floats
    after: Floats
    item: Floats
    plate: Floats | None
    item_material: Material
    scene_material: Material
    action: tuple[float, float] | None


def make_case(name: str, trial: DepthTrial, *, camera: Camera, grid: Grid) -> Case:
    """Return a trial as a case whose target is the scene after.

    The item's centre of area becomes the grid's centre. Everything on the plate has one material.

    Raises:
        RequestError: An image does not show the grid, or there is no item.
    """
    before = heightmap_from_depth(trial.before, camera, grid).heights
    after = heightmap_from_depth(trial.after, camera, grid).heights
    fries = _is_food(before - _plate(trial, camera, grid, np.zeros(2)), grid, np.zeros(2))
    state = State(Scene(grid, before, _materials(fries, trial.scene_material)), _item(trial, camera, grid))
    return Case(name, 0, state, after, trial.action, same_item=True, notes="Imported from depth images.")


def _item(trial: DepthTrial, camera: Camera, grid: Grid) -> Item:
    """Return the item with its centre of area at the grid's centre: found once, then drawn again about it."""
    rise, inside, centre = np.zeros(grid.shape), np.zeros(grid.shape, dtype=bool), np.zeros(2)
    for _ in range(2):
        rise = heightmap_from_depth(trial.item, camera.moved(centre), grid).heights
        rise = rise - _plate(trial, camera, grid, centre)
        inside = _is_food(rise, grid, centre)
        if not inside.any():
            raise RequestError(f"item: expected something at least {1e3 * LEAST_THICKNESS:g} mm thick, got none")
        rows, columns = np.nonzero(inside)
        centre = centre + np.array([grid.x[columns].mean(), grid.y[rows].mean()])
    return Item(np.where(inside, rise, 0.0).astype(np.float32), _materials(inside, trial.item_material))


def _plate(trial: DepthTrial, camera: Camera, grid: Grid, centre: Floats) -> Floats:
    """Return the empty plate's heights ``(H, W)`` [m] on a grid about ``centre``."""
    if trial.plate is not None:
        return heightmap_from_depth(trial.plate, camera.moved(centre), grid).heights
    return dinner_plate().height(np.hypot(grid.x[None, :] + centre[0], grid.y[:, None] + centre[1]))


def _is_food(rise: Floats, grid: Grid, centre: Floats) -> NDArray[np.bool_]:
    """Return where something lies inside the plate's rim: where most of a cell's neighbours rise above the plate."""
    padded = np.pad(rise > LEAST_THICKNESS, 1)
    height, width = rise.shape
    votes = sum(
        padded[row : row + height, column : column + width].astype(int) for row in range(3) for column in range(3)
    )
    radius = np.hypot(grid.x[None, :] + centre[0], grid.y[:, None] + centre[1])
    return (votes >= 5) & (rise > LEAST_THICKNESS / 2) & (radius < INSIDE_RIM)


def _materials(inside: NDArray[np.bool_], material: Material) -> NDArray[np.float32]:
    numbers = np.array([material.density, material.youngs_modulus, material.poisson_ratio])
    return (numbers[:, None, None] * inside).astype(np.float32)
