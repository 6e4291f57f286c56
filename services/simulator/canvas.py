"""Heightmaps of settled worlds: the item's surface and the boxes, seen from above."""

from dataclasses import dataclass

import numpy as np
import warp as wp
from numpy.typing import NDArray

from common.domain.bodies import Plate
from common.domain.grid import SUBSAMPLES, Grid
from services.simulator import raster
from services.simulator.bodies import Body
from services.simulator.device import upload
from services.simulator.mesh import Mesh
from services.simulator.outline import Outline
from services.simulator.simulation import Simulation


@dataclass(frozen=True)
class Skin:
    """The item's surface as seen from above: every pixel is a column with a level top and walls down to its neighbours.

    Attributes:
        points: Vertices in the item's frame ``(V, 3)`` [m].
        triangles: Vertex indices ``(F, 3)``.
    """

    points: NDArray[np.float64]
    triangles: NDArray[np.int32]


@dataclass(frozen=True)
class Drawing:
    """What was seen from above, means over the cells ``(W, H, W)``.

    Attributes:
        heights: The topmost surface [m].
        without_item: The same as if the item were not there [m].
        uncovered: Share of each cell that the item does not cover [-].
        pixels: Where the middle of the top of each of the item's pixels is ``(W, P, 3)`` [m].
    """

    heights: NDArray[np.float32]
    without_item: NDArray[np.float32]
    uncovered: NDArray[np.float32]
    pixels: NDArray[np.float32]


def skin_of(outline: Outline) -> Skin:
    """Cover top and walls of an item; columns share no vertices, so that their means are the pixels' thicknesses."""
    rows, columns = np.nonzero(outline.covered)
    height = outline.thickness[rows, columns]
    index = np.full(outline.covered.shape, -1)
    index[rows, columns] = np.arange(len(rows))
    around = np.array([[-1, -1], [1, -1], [1, 1], [-1, 1]]) / 2
    plane = outline.centres[:, None] + outline.pixel * around  # (P, 4, 2)
    top = np.dstack([plane, np.repeat(height[:, None], 4, axis=1)])
    points, count = [top.reshape(-1, 3)], 4 * len(rows)
    first = 4 * np.arange(len(rows))
    faces = [np.stack([first, first + 1, first + 2], axis=1), np.stack([first, first + 2, first + 3], axis=1)]
    for side, (row, column) in enumerate(((-1, 0), (0, 1), (1, 0), (0, -1))):
        lower = outline.thickness[rows + row, columns + column]
        walls = np.flatnonzero(lower < height)
        a, b = first[walls] + side, first[walls] + (side + 1) % 4
        feet = top[walls][:, [side, (side + 1) % 4]]
        feet[..., 2] = lower[walls, None]
        c = count + 2 * np.arange(len(walls))
        points.append(feet.reshape(-1, 3))
        faces += [np.stack([a, b, c], axis=1), np.stack([b, c + 1, c], axis=1)]
        count += 2 * len(walls)
    return Skin(np.concatenate(points), np.concatenate(faces).astype(np.int32))


class Canvas:
    """Draws the worlds of one simulation on one grid.

    Args:
        simulation: Where nodes and bodies are read from.
        outline: The item.
        mesh: Its mesh, which carries the skin of a soft item.
        item: The item as a body if it is rigid.
        grid: The grid of the heightmaps.
        plate: The plate below everything.
    """

    def __init__(
        self, simulation: Simulation, outline: Outline, mesh: Mesh, item: Body | None, grid: Grid, plate: Plate
    ) -> None:
        self._simulation = simulation
        self._cell = grid.cell
        device, count = simulation.device, simulation.count
        skin = skin_of(outline)
        self._rigid = item is not None
        self._pixels = int(outline.covered.sum())
        self._ground = upload(plate.heightmap(grid), float, device)
        self._offsets = upload(SUBSAMPLES, wp.vec2, device)
        self._boxes = wp.empty((count, *grid.shape, len(SUBSAMPLES)), dtype=float, device=device)
        self._item = wp.empty_like(self._boxes)
        self._means = [wp.empty((count, *grid.shape), dtype=float, device=device) for _ in range(3)]
        self._triangles = upload(skin.triangles, int, device)
        self._vertices = wp.zeros((count, len(skin.points)), dtype=wp.vec3, device=device)
        if item is not None:
            self._points = upload(skin.points - item.centre, wp.vec3, device)
        else:
            cells, weights = mesh.embed(skin.points)
            self._carriers = upload(cells, int, device), upload(weights, float, device)

    def draw_scene(self, poses: tuple[NDArray[np.float64], NDArray[np.float64]]) -> NDArray[np.float32]:
        """Return plate and boxes at given poses, without the item ``(W, H, W)`` [m]."""
        worlds = self._simulation.worlds
        if self._simulation.bodies:
            worlds.p.assign(poses[0].astype(np.float32))
            worlds.q.assign(poses[1].astype(np.float32))
        return self._draw(with_item=False).heights

    def draw(self) -> Drawing:
        """Return plate, boxes and item where they are now."""
        return self._draw(with_item=True)

    def _draw(self, *, with_item: bool) -> Drawing:
        simulation = self._simulation
        count, device = simulation.count, simulation.device
        inputs = [simulation.rigid, simulation.worlds, self._cell, self._offsets, self._boxes]
        wp.launch(raster.draw_boxes, self._boxes.shape[:3], inputs, device=device)
        self._item.fill_(float(raster.NOTHING))
        if with_item:
            size = (count, self._vertices.shape[1])
            if self._rigid:
                inputs = [simulation.worlds, self._points, self._vertices]
                wp.launch(raster.place_rigid_vertices, size, inputs, device=device)
            else:
                inputs = [simulation.solid, simulation.worlds, *self._carriers, self._vertices]
                wp.launch(raster.place_soft_vertices, size, inputs, device=device)
            inputs = [self._triangles, self._vertices, self._cell, self._offsets, self._item]
            wp.launch(raster.draw_triangles, (count, len(self._triangles)), inputs, device=device)
        inputs = [self._ground, self._boxes, self._item, *self._means]
        wp.launch(raster.blend, self._boxes.shape[:3], inputs, device=device)
        heights, without_item, uncovered = (np.array(mean.numpy(), dtype=np.float32) for mean in self._means)
        tops = self._vertices.numpy()[:, : 4 * self._pixels].reshape(count, -1, 4, 3)
        return Drawing(heights, without_item, uncovered, tops.mean(axis=2))
