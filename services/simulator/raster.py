# type: ignore
# Kernels are written in Warp's language, which a checker of Python misreads.
"""Kernels that draw the item's surface and the boxes from above."""

# float(0.0) declares a variable that a loop may change, 0.0 a constant, and there is no `in`.
# ruff: noqa: UP018, RUF046

import warp as wp

from services.simulator.arrays import Rigid, Solid, Worlds
from services.simulator.device import MODULE
from services.simulator.surfaces import box_distance

EDGE_TOLERANCE = wp.constant(1.0e-5)
"""Cell centres this far outside a triangle (as a share of its height) still belong to it: neighbours leave no gap."""
MARCH_STEPS = wp.constant(64)


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
