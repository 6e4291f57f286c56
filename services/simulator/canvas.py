"""Heightmaps of settled worlds: the item's surface and the boxes, seen from above."""

from dataclasses import dataclass

import numpy as np
import warp as wp
from numpy.typing import NDArray

from common.domain.bodies import Plate
from common.domain.grid import Grid
from services.simulator import raster
from services.simulator.bodies import Body
from services.simulator.device import upload
from services.simulator.mesh import Mesh
from services.simulator.outline import Outline
from services.simulator.simulation import Simulation


@dataclass(frozen=True)
class Skin:
    """The item's visible surface: its top, a pyramid of four triangles a pixel, and its walls.

    Attributes:
        points: Vertices in the item's frame ``(V, 3)`` [m].
        triangles: Vertex indices ``(F, 3)``.
    """

    points: NDArray[np.float64]
    triangles: NDArray[np.int32]


def skin_of(outline: Outline) -> Skin:
    """Cover top and walls of an item; the vertex in a pixel's middle has the pixel's own thickness."""
    covered = outline.covered
    rows, columns = np.nonzero(covered)
    shape = outline.lattice.shape
    grid_row, grid_column = np.divmod(np.arange(shape[0] * shape[1]), shape[1])
    plane = outline.corner + np.stack([grid_column, grid_row], axis=1) * outline.pixel
    top = np.column_stack([plane, outline.lattice.ravel()])
    bottom = np.column_stack([plane, np.zeros(len(plane))])
    middle = np.column_stack([outline.centres, outline.thickness[rows, columns]])
    first = rows * shape[1] + columns
    ring = [first, first + 1, first + shape[1] + 1, first + shape[1]]
    peak = 2 * len(plane) + np.arange(len(rows))
    faces = [np.stack([peak, ring[i], ring[(i + 1) % 4]], axis=1) for i in range(4)]
    for i, (row, column) in enumerate(((-1, 0), (0, 1), (1, 0), (0, -1))):
        outer = ~covered[rows + row, columns + column]
        a, b = ring[i][outer], ring[(i + 1) % 4][outer]
        faces += [np.stack([a, b, a + len(plane)], axis=1), np.stack([b, b + len(plane), a + len(plane)], axis=1)]
    points, triangles = np.concatenate([top, bottom, middle]), np.concatenate(faces)
    used, triangles = np.unique(triangles, return_inverse=True)
    return Skin(points[used], triangles.reshape(-1, 3).astype(np.int32))


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
        self._ground = upload(np.repeat(plate.heightmap(grid)[None], count, axis=0), float, device)
        self._heights = wp.zeros_like(self._ground)
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
        self._draw_boxes()
        return np.array(self._heights.numpy(), dtype=np.float32)

    def draw(self) -> NDArray[np.float32]:
        """Return plate, boxes and item where they are now ``(W, H, W)`` [m]."""
        simulation = self._simulation
        count, device = simulation.count, simulation.device
        self._draw_boxes()
        size = (count, self._vertices.shape[1])
        if self._rigid:
            wp.launch(
                raster.place_rigid_vertices, size, [simulation.worlds, self._points, self._vertices], device=device
            )
        else:
            inputs = [simulation.solid, simulation.worlds, *self._carriers, self._vertices]
            wp.launch(raster.place_soft_vertices, size, inputs, device=device)
        wp.launch(
            raster.draw_triangles,
            (count, len(self._triangles)),
            [self._triangles, self._vertices, self._cell, self._heights],
            device=device,
        )
        return np.array(self._heights.numpy(), dtype=np.float32)

    def _draw_boxes(self) -> None:
        simulation = self._simulation
        wp.copy(self._heights, self._ground)
        wp.launch(
            raster.draw_boxes,
            self._heights.shape,
            [simulation.rigid, simulation.worlds, self._cell, self._heights],
            device=simulation.device,
        )
