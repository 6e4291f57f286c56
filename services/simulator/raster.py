# type: ignore
# Kernels are written in Warp's language, which a checker of Python misreads.
"""Kernels that draw the item's surface and the boxes from above, at several points of every cell."""

# float(0.0) declares a variable that a loop may change, 0.0 a constant, and there is no `in`.
# ruff: noqa: UP018, RUF046

import warp as wp

from services.simulator.arrays import Rigid, Solid, Worlds
from services.simulator.device import MODULE
from services.simulator.surfaces import BOX_ROUNDING, box_distance

EDGE_TOLERANCE = wp.constant(1.0e-5)
"""Points this far outside a triangle (as a share of its height) still belong to it: neighbours leave no gap."""
NOTHING = wp.constant(-1.0e3)
"""Height where nothing is [m]."""
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
    offsets: wp.array[wp.vec2],
    tops: wp.array4d[float],
):
    """Raise the points ``tops (W, H, W, K)`` that lie in a triangle to the triangle's height there."""
    w, face = wp.tid()
    rows = tops.shape[1]
    columns = tops.shape[2]
    half_x = 0.5 * float(columns - 1)
    half_y = 0.5 * float(rows - 1)
    a = vertices[w, triangles[face, 0]]
    b = vertices[w, triangles[face, 1]]
    c = vertices[w, triangles[face, 2]]
    ax = a[0] / cell + half_x
    ay = a[1] / cell + half_y
    bx = b[0] / cell + half_x - ax
    by = b[1] / cell + half_y - ay
    cx = c[0] / cell + half_x - ax
    cy = c[1] / cell + half_y - ay
    area = bx * cy - by * cx
    if wp.abs(area) < 1.0e-7:
        return
    low_x = ax + wp.min(0.0, wp.min(bx, cx))
    high_x = ax + wp.max(0.0, wp.max(bx, cx))
    low_y = ay + wp.min(0.0, wp.min(by, cy))
    high_y = ay + wp.max(0.0, wp.max(by, cy))
    for row in range(wp.max(int(wp.ceil(low_y - 0.501)), 0), wp.min(int(wp.floor(high_y + 0.501)), rows - 1) + 1):
        for column in range(
            wp.max(int(wp.ceil(low_x - 0.501)), 0), wp.min(int(wp.floor(high_x + 0.501)), columns - 1) + 1
        ):
            for k in range(offsets.shape[0]):
                x = float(column) + offsets[k][0] - ax
                y = float(row) + offsets[k][1] - ay
                share_b = (x * cy - y * cx) / area
                share_c = (bx * y - by * x) / area
                if wp.min(1.0 - share_b - share_c, wp.min(share_b, share_c)) >= -EDGE_TOLERANCE:
                    z = a[2] + share_b * (b[2] - a[2]) + share_c * (c[2] - a[2])
                    wp.atomic_max(tops, w, row, column, k, z)


@wp.func(module=MODULE)
def box_top(rigid: Rigid, worlds: Worlds, w: int, body: int, x: float, y: float):
    """Return the height of a box over a point, `NOTHING` beside it, by marching along the signed distance [m]."""
    reach = rigid.reach[body]
    down = wp.quat_rotate_inv(worlds.q[w, body], wp.vec3(0.0, 0.0, -1.0))
    offset = wp.vec3(x - worlds.p[w, body][0], y - worlds.p[w, body][1], reach)
    start = wp.quat_rotate_inv(worlds.q[w, body], offset)
    enters = float(0.0)
    leaves = float(2.0) * reach
    for axis in range(3):
        half = rigid.core[body][axis] + BOX_ROUNDING
        slope = down[axis]
        if wp.abs(slope) < 1.0e-7:
            slope = 1.0e-7
        first = (-half - start[axis]) / slope
        second = (half - start[axis]) / slope
        enters = wp.max(enters, wp.min(first, second))
        leaves = wp.min(leaves, wp.max(first, second))
    step = int(0)
    while step < MARCH_STEPS and enters < leaves:
        gap = box_distance(rigid.core[body], start + enters * down)[3]
        enters += gap
        if gap < 1.0e-6:
            return worlds.p[w, body][2] + reach - enters
        step += 1
    return NOTHING


@wp.kernel(module=MODULE)
def draw_boxes(rigid: Rigid, worlds: Worlds, cell: float, offsets: wp.array[wp.vec2], tops: wp.array4d[float]):
    """Set the points ``tops (W, H, W, K)`` to the top of the highest box over each."""
    w, row, column = wp.tid()
    x = (float(column) - 0.5 * float(tops.shape[2] - 1)) * cell
    y = (float(row) - 0.5 * float(tops.shape[1] - 1)) * cell
    for k in range(offsets.shape[0]):
        tops[w, row, column, k] = NOTHING
    for box in range(rigid.boxes):
        body = rigid.first_box + box
        reach = rigid.reach[body] + cell
        dx = x - worlds.p[w, body][0]
        dy = y - worlds.p[w, body][1]
        if dx * dx + dy * dy < reach * reach:
            for k in range(offsets.shape[0]):
                top = box_top(rigid, worlds, w, body, x + cell * offsets[k][0], y + cell * offsets[k][1])
                tops[w, row, column, k] = wp.max(tops[w, row, column, k], top)


@wp.kernel(module=MODULE)
def blend(
    ground: wp.array2d[float],
    boxes: wp.array4d[float],
    item: wp.array4d[float],
    heights: wp.array3d[float],
    without_item: wp.array3d[float],
    uncovered: wp.array3d[float],
):
    """Average the points of each cell, with and without the item, and note the share that the item does not cover."""
    w, row, column = wp.tid()
    count = item.shape[3]
    below = ground[row, column]
    total = float(0.0)
    lower = float(0.0)
    free = float(0.0)
    for k in range(count):
        bare = wp.max(below, boxes[w, row, column, k])
        top = item[w, row, column, k]
        lower += bare
        total += wp.max(bare, top)
        if top <= bare:
            free += 1.0
    heights[w, row, column] = total / float(count)
    without_item[w, row, column] = lower / float(count)
    uncovered[w, row, column] = free / float(count)
