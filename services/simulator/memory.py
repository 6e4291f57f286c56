# type: ignore
# Kernels are written in Warp's language, which a checker of Python misreads.
"""What contacts carry from one time step to the next: who is near whom, and where springs are anchored."""

# float(0.0) declares a variable that a loop may change, 0.0 a constant, and there is no `in`.
# ruff: noqa: UP018, RUF046

import warp as wp

from services.simulator.arrays import (
    ENDED,
    FIRST_BOX,
    NEAR_PLATE,
    PLATE,
    TRAY,
    Laws,
    Plates,
    Rigid,
    Solid,
    Worlds,
)
from services.simulator.contact import FEELS_PLATE, FEELS_TRAY, clipped_stretch, node_mix
from services.simulator.device import MODULE
from services.simulator.surfaces import box_distance, plate_distance

WIDEST_MARGIN = wp.constant(0.006)
SMALLEST_MARGIN = wp.constant(0.002)
"""What is this much beyond touching counts as near for the length of one step, more the more the last one moved [m].

A step that goes further ends there.
"""


@wp.func(module=MODULE)
def search_margin(worlds: Worlds, w: int):
    """Return how far beyond touching the contact search looks [m]."""
    if worlds.fresh[w] == 1:
        return float(WIDEST_MARGIN)
    return wp.min(WIDEST_MARGIN, SMALLEST_MARGIN + 2.0 * worlds.moved[w])


@wp.func(module=MODULE)
def obstacles_near(plate: Plates, rigid: Rigid, worlds: Worlds, w: int, centre: wp.vec3, radius: float, own: int):
    """Return the bit set of boxes that a sphere may touch in the next step, ``own`` left out, and `NEAR_PLATE`."""
    near = int(0)
    margin = search_margin(worlds, w)
    r = wp.sqrt(centre[0] * centre[0] + centre[1] * centre[1])
    last = plate.ceiling.shape[0] - 1
    inner = wp.min(int(wp.max(r - radius, 0.0) / plate.bin), last)
    outer = wp.min(int((r + radius) / plate.bin), last)
    for ring in range(inner, outer + 1):
        if centre[2] - radius - margin < plate.ceiling[ring]:
            near = NEAR_PLATE
    for box in range(rigid.boxes):
        body = rigid.first_box + box
        if body != own:
            offset = centre - worlds.p[w, body]
            if wp.length(offset) < rigid.reach[body] + radius + margin:
                surface = box_distance(rigid.core[body], wp.quat_rotate_inv(worlds.q[w, body], offset))
                if surface[3] < radius + margin:
                    near = near | (1 << box)
    return near


@wp.kernel(module=MODULE)
def find_near_soft(plate: Plates, solid: Solid, rigid: Rigid, worlds: Worlds):
    """Note what is near each hexahedron of the soft item."""
    w, e = wp.tid()
    if worlds.phase[w] != ENDED:
        return
    centre = wp.vec3()
    for i in range(8):
        centre += 0.125 * worlds.x[w, solid.cells[e, i]]
    radius = float(0.0)
    for i in range(8):
        radius = wp.max(radius, wp.length(worlds.x[w, solid.cells[e, i]] - centre))
    worlds.was_near[w, e] = worlds.near[w, e]
    worlds.near[w, e] = obstacles_near(plate, rigid, worlds, w, centre, radius, -1)


@wp.kernel(module=MODULE)
def find_near_rigid(plate: Plates, rigid: Rigid, worlds: Worlds):
    """Note what is near each patch of the rigid bodies."""
    w, patch = wp.tid()
    if worlds.phase[w] != ENDED:
        return
    own = rigid.patch_body[patch]
    centre = worlds.p[w, own] + wp.quat_rotate(worlds.q[w, own], rigid.patch_centre[patch])
    slot = rigid.first_patch + patch
    worlds.was_near[w, slot] = worlds.near[w, slot]
    worlds.near[w, slot] = obstacles_near(plate, rigid, worlds, w, centre, rigid.patch_radius[patch], own)


@wp.func(module=MODULE)
def remember_soft_sample(
    laws: Laws, plate: Plates, solid: Solid, rigid: Rigid, worlds: Worlds, w: int, s: int, near: int, was_near: int
):
    """Set the anchors of one sample of the soft item, and weigh what the tray still carries of it."""
    kind = solid.kind[s]
    touched = worlds.touched[w, s] & was_near
    if near == 0 and (kind != FEELS_TRAY or worlds.tray_on[w] == 0):
        return
    point = node_mix(solid, worlds, w, s)
    k = solid.normal_stiffness[s]
    fresh = worlds.fresh[w]
    if kind <= FEELS_PLATE and near & NEAR_PLATE != 0:
        stretch = wp.vec3()
        if touched & NEAR_PLATE != 0:
            surface = plate_distance(plate, point)
            n = wp.vec3(surface[0], surface[1], surface[2])
            stretch = clipped_stretch(laws, k, surface[3], n, point - worlds.anchor[w, s, PLATE])
        worlds.anchor[w, s, PLATE] = point - stretch
    if kind == FEELS_TRAY and worlds.tray_on[w] == 1:
        gap = point[2] - worlds.tray[w]
        stretch = clipped_stretch(laws, k, gap, wp.vec3(0.0, 0.0, 1.0), point - worlds.anchor[w, s, TRAY])
        worlds.anchor[w, s, TRAY] = point - stretch * float(1 - fresh)
        if gap < 0.0:
            wp.atomic_add(worlds.tray_load, w, -k * gap)
    near = near & ~NEAR_PLATE
    box = int(0)
    while near != 0:
        if near & 1 == 1:
            body = rigid.first_box + box
            local = wp.quat_rotate_inv(worlds.q[w, body], point - worlds.p[w, body])
            stretch = wp.vec3()
            if (touched >> box) & 1 == 1:
                surface = box_distance(rigid.core[body], local)
                n = wp.vec3(surface[0], surface[1], surface[2])
                stretch = clipped_stretch(laws, k, surface[3], n, local - worlds.anchor[w, s, FIRST_BOX + box])
            worlds.anchor[w, s, FIRST_BOX + box] = local - stretch
        near = near >> 1
        box += 1


@wp.func(module=MODULE)
def remember_rigid_sample(
    laws: Laws, plate: Plates, rigid: Rigid, worlds: Worlds, w: int, t: int, near: int, was_near: int
):
    """Set touching points and anchors of one sample of a rigid body.

    A rounded edge that rolls touches elsewhere than before: the touching point is chosen anew, the spring keeps its
    length.
    """
    kind = rigid.kind[t]
    touched = worlds.body_touched[w, t] & was_near
    if near == 0 and (kind != FEELS_TRAY or worlds.tray_on[w] == 0):
        return
    own = rigid.body[t]
    orientation = worlds.q[w, own]
    origin = worlds.p[w, own]
    centre = origin + wp.quat_rotate(orientation, rigid.point[t])
    k = rigid.normal_stiffness[t]
    radius = rigid.radius[t]
    fresh = worlds.fresh[w]
    if kind <= FEELS_PLATE and near & NEAR_PLATE != 0:
        surface = plate_distance(plate, centre)
        n = wp.vec3(surface[0], surface[1], surface[2])
        stretch = wp.vec3()
        if touched & NEAR_PLATE != 0:
            old = origin + wp.quat_rotate(orientation, worlds.grip[w, t, PLATE])
            stretch = clipped_stretch(laws, k, surface[3] - radius, n, old - worlds.body_anchor[w, t, PLATE])
        touching = centre - radius * n
        worlds.grip[w, t, PLATE] = wp.quat_rotate_inv(orientation, touching - origin)
        worlds.body_anchor[w, t, PLATE] = touching - stretch
    if kind == FEELS_TRAY and worlds.tray_on[w] == 1:
        n = wp.vec3(0.0, 0.0, 1.0)
        gap = centre[2] - radius - worlds.tray[w]
        stretch = wp.vec3()
        if fresh == 0:
            old = origin + wp.quat_rotate(orientation, worlds.grip[w, t, TRAY])
            stretch = clipped_stretch(laws, k, gap, n, old - worlds.body_anchor[w, t, TRAY])
        touching = centre - radius * n
        worlds.grip[w, t, TRAY] = wp.quat_rotate_inv(orientation, touching - origin)
        worlds.body_anchor[w, t, TRAY] = touching - stretch
        if gap < 0.0:
            wp.atomic_add(worlds.tray_load, w, -k * gap)
    near = near & ~NEAR_PLATE
    box = int(0)
    while near != 0:
        if near & 1 == 1:
            body = rigid.first_box + box
            turn = worlds.q[w, body]
            local = wp.quat_rotate_inv(turn, centre - worlds.p[w, body])
            surface = box_distance(rigid.core[body], local)
            n = wp.vec3(surface[0], surface[1], surface[2])
            stretch = wp.vec3()
            if (touched >> box) & 1 == 1:
                old = origin + wp.quat_rotate(orientation, worlds.grip[w, t, FIRST_BOX + box]) - worlds.p[w, body]
                stretch = clipped_stretch(
                    laws,
                    k,
                    surface[3] - radius,
                    n,
                    wp.quat_rotate_inv(turn, old) - worlds.body_anchor[w, t, FIRST_BOX + box],
                )
            touching = local - radius * n
            worlds.grip[w, t, FIRST_BOX + box] = wp.quat_rotate_inv(
                orientation, worlds.p[w, body] + wp.quat_rotate(turn, touching) - origin
            )
            worlds.body_anchor[w, t, FIRST_BOX + box] = touching - stretch
        near = near >> 1
        box += 1


@wp.kernel(module=MODULE)
def remember_soft(laws: Laws, plate: Plates, solid: Solid, rigid: Rigid, worlds: Worlds):
    """Set the anchors of the soft item's samples for the next step, and weigh what the tray still carries."""
    w, e = wp.tid()
    if worlds.phase[w] == ENDED:
        near = worlds.near[w, e]
        if near != 0 or worlds.tray_on[w] == 1:
            for s in range(solid.first_sample[e], solid.first_sample[e + 1]):
                remember_soft_sample(laws, plate, solid, rigid, worlds, w, s, near, worlds.was_near[w, e])


@wp.kernel(module=MODULE)
def remember_rigid(laws: Laws, plate: Plates, rigid: Rigid, worlds: Worlds):
    """Set touching points and anchors of the rigid bodies' samples for the next step."""
    w, patch = wp.tid()
    if worlds.phase[w] == ENDED:
        slot = rigid.first_patch + patch
        near = worlds.near[w, slot]
        if near != 0 or worlds.tray_on[w] == 1:
            for t in range(rigid.first_sample[patch], rigid.first_sample[patch + 1]):
                remember_rigid_sample(laws, plate, rigid, worlds, w, t, near, worlds.was_near[w, slot])
