"""A trial seen by a depth camera as a case: the scene before, the item, the action, the scene after."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage
from scipy.ndimage import binary_dilation

from common.domain.bodies import Material, Plate
from common.domain.camera import Camera
from common.domain.case import Case
from common.domain.errors import RequestError
from common.domain.grid import Floats, Grid
from common.domain.scene import Item, Scene, State
from common.domain.world import Sight
from common.tasks.plating import RIM_RADIUS, dinner_plate
from pipelines.data.depth import heightmap_from_depth
from pipelines.data.plate_pose import align
from pipelines.data.segmentation import HeightSegmenter, Segmenter

THINNEST = 0.002
"""No cell of an item is thinner [m]."""
INSIDE_RIM = RIM_RADIUS - 0.005
"""Food that was there before is looked for within this distance of the centre: the edge hides what is behind [m]."""
BESIDE = 1
"""A cell so near to food may show some of it; all others show the plate and take its height [cells]."""


@dataclass(frozen=True)
class Perceived:
    """A state as a camera saw it.

    Attributes:
        state: Scene and item; bodies are not known.
        camera: The camera, its pose put right.
        plate: The plate's profile.
    """

    state: State
    camera: Camera
    plate: Plate

    def outcome(self, after: Floats, *, segmenter: Segmenter | None = None) -> NDArray[np.float32]:
        """Return the heightmap of a depth image of the scene after an action ``(H, W)`` [m]."""
        everywhere = np.ones(self.state.grid.shape, dtype=bool)
        segmenter = segmenter or HeightSegmenter()
        return _surface(after, self.camera, self.state.grid, self.plate, segmenter, within=everywhere)[0]


def perceive(sight: Sight, *, grid: Grid, segmenter: Segmenter | None = None) -> Perceived:
    """Return the state that depth images show (real to sim).

    An image of the empty plate puts the camera's pose right and tells the plate's profile; else both are taken as they
    are told, the plate as the default one. The item's centre of area becomes the grid's centre. Everything on the
    plate has one material. Where no food is near, heights are the plate's.

    Args:
        sight: What the camera saw.
        grid: The grid of the state.
        segmenter: Tells food from plate; by height if None.

    Raises:
        RequestError: An image does not show the grid, or there is no item or no plate.
    """
    segmenter, camera, plate = segmenter or HeightSegmenter(), sight.camera, dinner_plate()
    if sight.plate is not None:
        camera, plate = align(sight.plate, camera, plate)
    inside = np.hypot(grid.x[None, :], grid.y[:, None]) < INSIDE_RIM
    heights, food = _surface(sight.before, camera, grid, plate, segmenter, within=inside)
    scene = Scene(grid, heights, _materials(food, sight.scene_material))
    item = _item(sight.item, sight.item_material, camera, grid, plate, segmenter)
    return Perceived(State(scene, item), camera, plate)


def make_case(
    name: str,
    sight: Sight,
    after: Floats,
    action: tuple[float, float] | None,
    *,
    grid: Grid,
    segmenter: Segmenter | None = None,
) -> Case:
    """Return a trial as a case whose target is the scene after; see `perceive`.

    Args:
        name: Name of the case.
        sight: What the camera saw before.
        after: Depth image with the item placed ``(h, w)`` [m].
        action: Where the item's centre was placed ``(x, y)`` [m]; None if nobody knows it.
        grid: The grid of the case.
        segmenter: Tells food from plate; by height if None.
    """
    found = perceive(sight, grid=grid, segmenter=segmenter)
    outcome = found.outcome(after, segmenter=segmenter)
    return Case(name, 0, found.state, outcome, action, same_item=True, notes="Imported from depth images.")


def _surface(
    depth: Floats, camera: Camera, grid: Grid, plate: Plate, segmenter: Segmenter, *, within: NDArray[np.bool_]
) -> tuple[NDArray[np.float32], NDArray[np.bool_]]:
    """Return heights, the plate's where no food is near, and where there is food ``(H, W)``."""
    bare = plate.heightmap(grid)
    seen = heightmap_from_depth(depth, camera, grid).heights
    food = (segmenter.segment(seen - bare, grid) > 0) & within
    near = binary_dilation(food, np.ones((3, 3)), iterations=BESIDE) if food.any() else food
    return np.where(near, seen, bare).astype(np.float32), food


def _item(depth: Floats, material: Material, camera: Camera, grid: Grid, plate: Plate, segmenter: Segmenter) -> Item:
    """Return the item with its centre of area at the grid's centre: found once, then drawn again about it."""
    rise, inside, centre = np.zeros(grid.shape), np.zeros(grid.shape, dtype=bool), np.zeros(2)
    for _ in range(2):
        x, y = grid.x[None, :] + centre[0], grid.y[:, None] + centre[1]
        rise = heightmap_from_depth(depth, camera.moved(centre), grid).heights - plate.height(np.hypot(x, y))
        inside = (segmenter.segment(rise, grid) > 0) & (np.hypot(x, y) < INSIDE_RIM)
        if not inside.any():
            raise RequestError("item: expected something that rises above the plate, got nothing")
        inside = _largest(inside)
        rows, columns = np.nonzero(inside)
        centre = centre + np.array([grid.x[columns].mean(), grid.y[rows].mean()])
    thickness = np.maximum(rise, THINNEST)
    return Item(np.where(inside, thickness, 0.0).astype(np.float32), _materials(inside, material))


def _largest(mask: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """Return the largest piece of a mask, with its holes filled."""
    pieces, count = ndimage.label(mask)  # type: ignore[misc]
    sizes = np.bincount(pieces.ravel(), minlength=count + 1)[1:]
    return np.asarray(ndimage.binary_fill_holes(pieces == 1 + int(sizes.argmax())))


def _materials(inside: NDArray[np.bool_], material: Material) -> NDArray[np.float32]:
    numbers = np.array([material.density, material.youngs_modulus, material.poisson_ratio])
    return (numbers[:, None, None] * inside).astype(np.float32)
