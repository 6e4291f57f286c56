"""Heightmaps of settled worlds: the item's surface and the boxes, seen from above."""

# In a kernel float(0.0) declares a variable that a loop may change, 0.0 a constant.
# ruff: noqa: UP018
# pyright: reportInvalidTypeForm=false
from dataclasses import dataclass

import numpy as np
import warp as wp
from numpy.typing import NDArray

from common.domain.bodies import ROUNDING, Plate
from common.domain.grid import Grid
from services.simulator.arrays import Rigid, Solid, Worlds
from services.simulator.bodies import Body
from services.simulator.device import MODULE, upload
from services.simulator.mesh import Mesh
from services.simulator.outline import Outline
from services.simulator.simulation import Simulation
from services.simulator.surfaces import box_distance

EDGE_TOLERANCE = wp.constant(1.0e-5)
"""Cell centres this far outside a triangle (as a share of its height) still belong to it: neighbours leave no gap."""
MARCH_STEPS = wp.constant(64)


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


@wp.kernel(module=MODULE)
def place_soft_vertices(
    solid: Solid,
    worlds: Worlds,
    cell: wp.array[int],
    weights: wp.array2d[float],
    vertices: wp.array2d[wp.vec3],
):
    """Carry the skin along with the mesh."""
    w, i = wp.tid()
    point = wp.vec3()
    for corner in range(8):
        point += weights[i, corner] * worlds.x[w, solid.cells[cell[i], corner]]
    vertices[w, i] = point


@wp.kernel(module=MODULE)
def place_rigid_vertices(worlds: Worlds, points: wp.array[wp.vec3], vertices: wp.array2d[wp.vec3]):
    """Carry the skin along with body 0."""
    w, i = wp.tid()
    vertices[w, i] = worlds.p[w, 0] + wp.quat_rotate(worlds.q[w, 0], points[i])


@wp.kernel(module=MODULE)
def draw_triangles(
    triangles: wp.array2d[int],
    vertices: wp.array2d[wp.vec3],
    cell: float,
    heights: wp.array3d[float],
):
    """Raise each cell whose centre lies in a triangle to the triangle's height there."""
    w, face = wp.tid()
    a = vertices[w, triangles[face, 0]]
    b = vertices[w, triangles[face, 1]]
    c = vertices[w, triangles[face, 2]]
    area = (b[0] - a[0]) * (c[1] - a[1]) - (b[1] - a[1]) * (c[0] - a[0])
    if wp.abs(area) < 1.0e-12:
        return
    rows = heights.shape[1]
    columns = heights.shape[2]
    half_x = 0.5 * float(columns - 1)
    half_y = 0.5 * float(rows - 1)
    low_x = wp.min(a[0], wp.min(b[0], c[0])) / cell + half_x
    high_x = wp.max(a[0], wp.max(b[0], c[0])) / cell + half_x
    low_y = wp.min(a[1], wp.min(b[1], c[1])) / cell + half_y
    high_y = wp.max(a[1], wp.max(b[1], c[1])) / cell + half_y
    for row in range(wp.max(int(wp.ceil(low_y - 0.001)), 0), wp.min(int(wp.floor(high_y + 0.001)), rows - 1) + 1):
        for column in range(
            wp.max(int(wp.ceil(low_x - 0.001)), 0), wp.min(int(wp.floor(high_x + 0.001)), columns - 1) + 1
        ):
            x = (float(column) - half_x) * cell
            y = (float(row) - half_y) * cell
            share_b = ((x - a[0]) * (c[1] - a[1]) - (y - a[1]) * (c[0] - a[0])) / area
            share_c = ((b[0] - a[0]) * (y - a[1]) - (b[1] - a[1]) * (x - a[0])) / area
            share_a = 1.0 - share_b - share_c
            if wp.min(share_a, wp.min(share_b, share_c)) >= -EDGE_TOLERANCE:
                z = share_a * a[2] + share_b * b[2] + share_c * c[2]
                wp.atomic_max(heights, w, row, column, z)


@wp.kernel(module=MODULE)
def draw_boxes(rigid: Rigid, worlds: Worlds, cell: float, heights: wp.array3d[float]):
    """Raise each cell to the top of every box over its centre, by marching along the signed distance."""
    w, row, column = wp.tid()
    x = (float(column) - 0.5 * float(heights.shape[2] - 1)) * cell
    y = (float(row) - 0.5 * float(heights.shape[1] - 1)) * cell
    top = heights[w, row, column]
    for box in range(rigid.boxes):
        body = rigid.first_box + box
        reach = rigid.reach[body]
        dx = x - worlds.p[w, body][0]
        dy = y - worlds.p[w, body][1]
        if dx * dx + dy * dy < reach * reach:
            local = wp.quat_rotate_inv(worlds.q[w, body], wp.vec3(dx, dy, reach))
            down = wp.quat_rotate_inv(worlds.q[w, body], wp.vec3(0.0, 0.0, -1.0))
            travelled = float(0.0)
            gap = float(1.0)
            step = int(0)
            while step < MARCH_STEPS and wp.abs(gap) > 1.0e-7 and travelled < 2.0 * reach:
                surface = box_distance(rigid.core[body], local + travelled * down)
                gap = surface[3]
                travelled += gap
                step += 1
            if gap < 2.0e-5:
                top = wp.max(top, worlds.p[w, body][2] + reach - travelled)
    heights[w, row, column] = top


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
        return self._heights.numpy().copy()

    def draw(self) -> NDArray[np.float32]:
        """Return plate, boxes and item where they are now ``(W, H, W)`` [m]."""
        simulation = self._simulation
        count, device = simulation.count, simulation.device
        self._draw_boxes()
        size = (count, self._vertices.shape[1])
        if self._rigid:
            wp.launch(place_rigid_vertices, size, [simulation.worlds, self._points, self._vertices], device=device)
        else:
            inputs = [simulation.solid, simulation.worlds, *self._carriers, self._vertices]
            wp.launch(place_soft_vertices, size, inputs, device=device)
        wp.launch(
            draw_triangles,
            (count, len(self._triangles)),
            [self._triangles, self._vertices, self._cell, self._heights],
            device=device,
        )
        return self._heights.numpy().copy()

    def _draw_boxes(self) -> None:
        simulation = self._simulation
        wp.copy(self._heights, self._ground)
        wp.launch(
            draw_boxes,
            self._heights.shape,
            [simulation.rigid, simulation.worlds, self._cell, self._heights],
            device=simulation.device,
        )
