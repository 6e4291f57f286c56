# type: ignore
# Kernels are written in Warp's language, which a checker of Python misreads.
"""Contact with friction between samples and obstacles, by springs that remember where they stuck.

A sample ``-g`` deep in an obstacle with outward normal ``n`` feels ``f_n = k_s(g) (-g)`` along ``n``. The secant
stiffness ``k_s`` grows linearly with the depth up to `Laws.softening`, beyond it the slope is ``k``. The tangential
spring has length ``u = P (c - a)``, ``P = I - n n^T``, between the touching point ``c`` and an anchor ``a`` that
moves with the obstacle: it sticks with ``f_t = -k_t u``, ``k_t = k_s`` times `Laws.stick_ratio`, while ``k_t |u| <=
mu f_n``, and slides with ``f_t = -mu f_n u / |u|`` beyond. At the end of a step a sliding anchor is drawn along to
the cone, and an open contact forgets its anchor.

Tangent: ``k n n^T + s P``, ``s = k_t`` sticking; ``s = mu f_n / |u|`` and ``P`` less ``u u^T / u^2`` sliding; the
unsymmetric part, by which friction follows the normal force, is left out.
"""

# float(0.0) declares a variable that a loop may change, 0.0 a constant, and there is no `in`.
# ruff: noqa: UP018, RUF046, SIM109

import warp as wp

from services.simulator.arrays import (
    DIRECTION,
    FIRST_BOX,
    NEAR_PLATE,
    PLATE,
    START,
    TRAY,
    TRIAL,
    Laws,
    Plates,
    Rigid,
    Solid,
    System,
    Worlds,
)
from services.simulator.device import MODULE
from services.simulator.elements import add_node_block
from services.simulator.samples import BOTTOM, SIDE
from services.simulator.surfaces import box_distance, plate_distance

FEELS_TRAY = wp.constant(BOTTOM)
FEELS_PLATE = wp.constant(SIDE)


@wp.func(module=MODULE)
def secant_stiffness(laws: Laws, stiffness: float, gap: float):
    """Return normal force over depth: the spring hardens up to ``softening``, smooth at first touch [N/m]."""
    if -gap < laws.softening:
        return -0.5 * stiffness * gap / laws.softening
    return stiffness * (1.0 + 0.5 * laws.softening / gap)


@wp.func(module=MODULE)
def contact_force(laws: Laws, stiffness: float, gap: float, n: wp.vec3, stretch: wp.vec3):
    """Return the force on a sample whose spring has length ``stretch`` (its normal part is ignored) [N]."""
    secant = secant_stiffness(laws, stiffness, gap)
    pressing = -secant * gap
    u = stretch - n * wp.dot(n, stretch)
    length = wp.length(u)
    most = laws.friction * pressing
    tangential = laws.stick_ratio * secant
    if tangential * length > most:
        tangential = most / length
    return n * pressing - u * tangential


@wp.func(module=MODULE)
def contact_tangent(laws: Laws, stiffness: float, gap: float, n: wp.vec3, stretch: wp.vec3):
    """Return minus the derivative of the force, ``(3, 3)`` and positive semi-definite [N/m]."""
    u = stretch - n * wp.dot(n, stretch)
    length = wp.length(u)
    secant = secant_stiffness(laws, stiffness, gap)
    most = -laws.friction * secant * gap
    tangential = laws.stick_ratio * secant
    plane = wp.identity(n=3, dtype=float) - wp.outer(n, n)
    if tangential * length > most:
        tangential = most / length
        plane = plane - wp.outer(u, u) / (length * length)
    normal = stiffness * wp.min(1.0, -gap / laws.softening)
    return normal * wp.outer(n, n) + tangential * plane


@wp.func(module=MODULE)
def clipped_stretch(laws: Laws, stiffness: float, gap: float, n: wp.vec3, stretch: wp.vec3):
    """Return the spring's length at the end of a step: in the plane, on the cone at most, none if the gap is open."""
    if gap >= 0.0:
        return wp.vec3()
    u = stretch - n * wp.dot(n, stretch)
    length = wp.length(u)
    longest = -laws.friction * gap / laws.stick_ratio
    if length > longest:
        u = u * (longest / length)
    return u


@wp.func(module=MODULE)
def node_mix(solid: Solid, worlds: Worlds, w: int, s: int):
    """Return the position of a sample on the soft item at the trial point [m]."""
    e = solid.patch[s]
    point = wp.vec3()
    for i in range(solid.corners[s]):
        point += solid.weights[s, i] * worlds.x[w, solid.cells[e, i]]
    return point


@wp.func(module=MODULE)
def add_body_force(worlds: Worlds, w: int, b: int, arm: wp.vec3, force: wp.vec3):
    """Add a force at an arm from a body's centre."""
    wp.atomic_add(worlds.pf, w, b, force)
    wp.atomic_add(worlds.qf, w, b, wp.cross(arm, force))


@wp.func(module=MODULE)
def add_body_block(system: System, w: int, a: int, b: int, arm_a: wp.vec3, arm_b: wp.vec3, block: wp.mat33):
    """Add ``G_a^T K G_b`` with ``G = [I, -[arm]x]`` at bodies ``a <= b`` of the corner's upper half."""
    ka = wp.skew(arm_a) * block
    kb = -block * wp.skew(arm_b)
    kab = ka * -wp.skew(arm_b)
    for r in range(3):
        for c in range(3):
            if a != b or c >= r:
                wp.atomic_add(system.corner, w, 6 * a + r, 6 * b + c, block[r, c])
                wp.atomic_add(system.corner, w, 6 * a + 3 + r, 6 * b + 3 + c, kab[r, c])
            wp.atomic_add(system.corner, w, 6 * a + r, 6 * b + 3 + c, kb[r, c])
            if a != b:
                wp.atomic_add(system.corner, w, 6 * a + 3 + r, 6 * b + c, ka[r, c])


@wp.func(module=MODULE)
def add_sample_force(solid: Solid, worlds: Worlds, w: int, s: int, force: wp.vec3):
    """Spread a force over the nodes around a sample."""
    e = solid.patch[s]
    for i in range(solid.corners[s]):
        wp.atomic_add(worlds.f, w, solid.cells[e, i], solid.weights[s, i] * force)


@wp.func(module=MODULE)
def add_sample_tangent(solid: Solid, system: System, w: int, s: int, block: wp.mat33):
    """Spread a stiffness over the nodes around a sample."""
    e = solid.patch[s]
    for i in range(solid.corners[s]):
        a = solid.cells[e, i]
        for j in range(solid.corners[s]):
            b = solid.cells[e, j]
            weight = solid.weights[s, i] * solid.weights[s, j]
            if a <= b and weight != 0.0:
                add_node_block(system, w, a, b, weight * block)


@wp.func(module=MODULE)
def add_border(solid: Solid, system: System, w: int, s: int, body: int, arm: wp.vec3, block: wp.mat33):
    """Couple the nodes around a sample with a body: ``-w_i K G``."""
    e = solid.patch[s]
    turned = block * wp.skew(arm)
    for i in range(solid.corners[s]):
        weight = solid.weights[s, i]
        for r in range(3):
            start = (3 * solid.cells[e, i] + r) * system.row + system.band + 1 + 6 * body
            for c in range(3):
                wp.atomic_sub(system.bordered, w, start + c, weight * block[r, c])
                wp.atomic_add(system.bordered, w, start + 3 + c, weight * turned[r, c])


@wp.func(module=MODULE)
def touch_soft_sample(
    laws: Laws,
    plate: Plates,
    solid: Solid,
    rigid: Rigid,
    worlds: Worlds,
    system: System,
    tangent: bool,
    w: int,
    s: int,
    near: int,
):
    """Add what one sample of the soft item feels, and what the boxes feel of it."""
    kind = solid.kind[s]
    if near == 0 and kind != FEELS_TRAY:
        return
    touched = int(0)
    if tangent:  # the forces at this point have been computed
        near = worlds.touched[w, s]
        if near == 0 and (kind != FEELS_TRAY or worlds.tray_on[w] == 0):
            return
    point = node_mix(solid, worlds, w, s)
    k = solid.normal_stiffness[s]
    if kind <= FEELS_PLATE and near & NEAR_PLATE != 0:
        surface = plate_distance(plate, point)
        if surface[3] < 0.0:
            touched = touched | NEAR_PLATE
            n = wp.vec3(surface[0], surface[1], surface[2])
            stretch = point - worlds.anchor[w, s, PLATE]
            if tangent:
                add_sample_tangent(solid, system, w, s, contact_tangent(laws, k, surface[3], n, stretch))
            else:
                add_sample_force(solid, worlds, w, s, contact_force(laws, k, surface[3], n, stretch))
    if kind == FEELS_TRAY and worlds.tray_on[w] == 1:
        gap = point[2] - worlds.tray[w]
        if gap < 0.0:
            n = wp.vec3(0.0, 0.0, 1.0)
            stretch = point - worlds.anchor[w, s, TRAY]
            if tangent:
                add_sample_tangent(solid, system, w, s, contact_tangent(laws, k, gap, n, stretch))
            else:
                add_sample_force(solid, worlds, w, s, contact_force(laws, k, gap, n, stretch))
    near = near & ~NEAR_PLATE
    box = int(0)
    while near != 0:
        if near & 1 == 1:
            body = rigid.first_box + box
            arm = point - worlds.p[w, body]
            local = wp.quat_rotate_inv(worlds.q[w, body], arm)
            surface = box_distance(rigid.core[body], local)
            if surface[3] < 0.0:
                touched = touched | (1 << box)
                n = wp.quat_rotate(worlds.q[w, body], wp.vec3(surface[0], surface[1], surface[2]))
                stretch = wp.quat_rotate(worlds.q[w, body], local - worlds.anchor[w, s, FIRST_BOX + box])
                if tangent:
                    block = contact_tangent(laws, k, surface[3], n, stretch)
                    add_sample_tangent(solid, system, w, s, block)
                    add_border(solid, system, w, s, body, arm, block)
                    add_body_block(system, w, body, body, arm, arm, block)
                else:
                    force = contact_force(laws, k, surface[3], n, stretch)
                    add_sample_force(solid, worlds, w, s, force)
                    add_body_force(worlds, w, body, arm, -force)
        near = near >> 1
        box += 1
    if not tangent:
        worlds.touched[w, s] = touched


@wp.func(module=MODULE)
def touch_rigid_sample(
    laws: Laws,
    plate: Plates,
    rigid: Rigid,
    worlds: Worlds,
    system: System,
    tangent: bool,
    w: int,
    t: int,
    near: int,
):
    """Add what one sample of a rigid body feels, and what the boxes feel of it."""
    kind = rigid.kind[t]
    if near == 0 and kind != FEELS_TRAY:
        return
    touched = int(0)
    if tangent:  # the forces at this point have been computed
        near = worlds.body_touched[w, t]
        if near == 0 and (kind != FEELS_TRAY or worlds.tray_on[w] == 0):
            return
    own = rigid.body[t]
    orientation = worlds.q[w, own]
    centre = worlds.p[w, own] + wp.quat_rotate(orientation, rigid.point[t])
    k = rigid.normal_stiffness[t]
    radius = rigid.radius[t]
    if kind <= FEELS_PLATE and near & NEAR_PLATE != 0:
        surface = plate_distance(plate, centre)
        gap = surface[3] - radius
        if gap < 0.0:
            touched = touched | NEAR_PLATE
            n = wp.vec3(surface[0], surface[1], surface[2])
            arm = wp.quat_rotate(orientation, worlds.grip[w, t, PLATE])
            stretch = worlds.p[w, own] + arm - worlds.body_anchor[w, t, PLATE]
            if tangent:
                add_body_block(system, w, own, own, arm, arm, contact_tangent(laws, k, gap, n, stretch))
            else:
                add_body_force(worlds, w, own, arm, contact_force(laws, k, gap, n, stretch))
    if kind == FEELS_TRAY and worlds.tray_on[w] == 1:
        gap = centre[2] - radius - worlds.tray[w]
        if gap < 0.0:
            n = wp.vec3(0.0, 0.0, 1.0)
            arm = wp.quat_rotate(orientation, worlds.grip[w, t, TRAY])
            stretch = worlds.p[w, own] + arm - worlds.body_anchor[w, t, TRAY]
            if tangent:
                add_body_block(system, w, own, own, arm, arm, contact_tangent(laws, k, gap, n, stretch))
            else:
                add_body_force(worlds, w, own, arm, contact_force(laws, k, gap, n, stretch))
    near = near & ~NEAR_PLATE
    box = int(0)
    while near != 0:
        if near & 1 == 1:
            body = rigid.first_box + box
            local = wp.quat_rotate_inv(worlds.q[w, body], centre - worlds.p[w, body])
            surface = box_distance(rigid.core[body], local)
            gap = surface[3] - radius
            if gap < 0.0:
                touched = touched | (1 << box)
                n = wp.quat_rotate(worlds.q[w, body], wp.vec3(surface[0], surface[1], surface[2]))
                arm = wp.quat_rotate(orientation, worlds.grip[w, t, FIRST_BOX + box])
                anchor = wp.quat_rotate(worlds.q[w, body], worlds.body_anchor[w, t, FIRST_BOX + box])
                other_arm = worlds.p[w, own] + arm - worlds.p[w, body]
                stretch = other_arm - anchor
                if tangent:
                    block = contact_tangent(laws, k, gap, n, stretch)
                    add_body_block(system, w, own, own, arm, arm, block)
                    add_body_block(system, w, body, body, other_arm, other_arm, block)
                    if own < body:
                        add_body_block(system, w, own, body, arm, other_arm, -block)
                    else:
                        add_body_block(system, w, body, own, other_arm, arm, -block)
                else:
                    force = contact_force(laws, k, gap, n, stretch)
                    add_body_force(worlds, w, own, arm, force)
                    add_body_force(worlds, w, body, other_arm, -force)
        near = near >> 1
        box += 1
    if not tangent:
        worlds.body_touched[w, t] = touched


@wp.func(module=MODULE)
def is_wanted(phase: int, tangent: bool):
    """Tell whether forces, or the tangent, are evaluated in this phase."""
    if tangent:
        return phase == DIRECTION
    return phase == START or phase == TRIAL


@wp.kernel(module=MODULE)
def touch_soft(laws: Laws, plate: Plates, solid: Solid, rigid: Rigid, worlds: Worlds, system: System, tangent: bool):
    """Add what the soft item's samples feel, and what the boxes feel of them: forces or, if asked, the tangent.

    One thread takes all samples of a hexahedron: on a CPU most of the time of an idle thread goes into its start.
    """
    w, e = wp.tid()
    if is_wanted(worlds.phase[w], tangent):
        near = worlds.near[w, e]
        if near != 0 or worlds.tray_on[w] == 1:
            for s in range(solid.first_sample[e], solid.first_sample[e + 1]):
                touch_soft_sample(laws, plate, solid, rigid, worlds, system, tangent, w, s, near)


@wp.kernel(module=MODULE)
def touch_rigid(laws: Laws, plate: Plates, rigid: Rigid, worlds: Worlds, system: System, tangent: bool):
    """Add what the rigid bodies' samples feel, and what the boxes feel of them: forces or, if asked, the tangent.

    One thread takes all samples of a patch.
    """
    w, patch = wp.tid()
    if is_wanted(worlds.phase[w], tangent):
        near = worlds.near[w, rigid.first_patch + patch]
        if near != 0 or worlds.tray_on[w] == 1:
            for t in range(rigid.first_sample[patch], rigid.first_sample[patch + 1]):
                touch_rigid_sample(laws, plate, rigid, worlds, system, tangent, w, t, near)
