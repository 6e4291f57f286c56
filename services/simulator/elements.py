# type: ignore
# Kernels are written in Warp's language, which a checker of Python misreads.
"""Corotated hexahedra: elastic forces and their tangent."""

import warp as wp

from services.simulator.arrays import DIRECTION, START, TRIAL, Solid, System, Worlds
from services.simulator.device import MODULE

POLAR_ITERATIONS = wp.constant(12)


@wp.func(module=MODULE)
def rotation_of(deformation: wp.mat33):
    """Return the rotation of a polar decomposition by Higham's iteration ``R <- (R + R^-T) / 2``."""
    turn = deformation
    if wp.determinant(turn) < 1.0e-3:  # flat or inside out: the singular value decomposition still has an answer
        u = wp.mat33()
        s = wp.vec3()
        v = wp.mat33()
        wp.svd3(deformation, u, s, v)
        return u * wp.transpose(v)
    for _i in range(POLAR_ITERATIONS):
        better = 0.5 * (turn + wp.transpose(wp.inverse(turn)))
        change = better - turn
        turn = better
        if wp.ddot(change, change) < 1.0e-12:
            break
    return turn


@wp.kernel(module=MODULE)
def add_elastic_forces(solid: Solid, worlds: Worlds):
    """Add ``f_i = -R sum_j K_ij (R^T (x_j - x_0) - (X_j - X_0))`` for every hexahedron.

    ``R`` is the rotation of the deformation gradient at the centre. Positions are taken relative to the first node,
    or single precision would cost the cantilever several percent.
    """
    w, e = wp.tid()
    phase = worlds.phase[w]
    if phase != START and phase != TRIAL:
        return
    origin = worlds.x[w, solid.cells[e, 0]]
    deformation = wp.mat33()
    for i in range(8):
        deformation += wp.outer(worlds.x[w, solid.cells[e, i]] - origin, solid.gradient[e, i])
    turn = rotation_of(deformation)
    worlds.turn[w, e] = turn
    back = wp.transpose(turn)
    shifts = wp.matrix(shape=(8, 3), dtype=float)
    for j in range(8):
        shift = back * (worlds.x[w, solid.cells[e, j]] - origin) - solid.rest[e, j]
        shifts[j] = shift
    for i in range(8):
        force = wp.vec3()
        for j in range(8):
            force += solid.stiffness[e, i * 8 + j] * shifts[j]
        wp.atomic_sub(worlds.f, w, solid.cells[e, i], turn * force)


@wp.func(module=MODULE)
def add_node_block(system: System, w: int, a: int, b: int, block: wp.mat33):
    """Add a 3 x 3 block at nodes ``a <= b`` of the upper band."""
    for r in range(3):
        start = (3 * a + r) * system.row + 3 * (b - a) - r
        for c in range(3):
            if a != b or c >= r:
                wp.atomic_add(system.bordered, w, start + c, block[r, c])


@wp.kernel(module=MODULE)
def add_elastic_tangent(solid: Solid, worlds: Worlds, system: System):
    """Add ``R K R^T`` of every hexahedron, the change of the rotation left out."""
    w, e = wp.tid()
    if worlds.phase[w] != DIRECTION:
        return
    turn = worlds.turn[w, e]
    back = wp.transpose(turn)
    for i in range(8):
        a = solid.cells[e, i]
        for j in range(8):
            b = solid.cells[e, j]
            if a <= b:
                add_node_block(system, w, a, b, turn * solid.stiffness[e, i * 8 + j] * back)
