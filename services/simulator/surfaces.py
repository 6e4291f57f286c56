# type: ignore
# Kernels are written in Warp's language, which a checker of Python misreads.
"""Signed distances to the plate and to rounded boxes, with normals."""

# float(0.0) declares a variable that a loop may change, 0.0 a constant, and there is no `in`.
# ruff: noqa: UP018, RUF046

import numpy as np
import warp as wp

from common.domain.bodies import ROUNDING, Plate
from services.simulator.arrays import Plates
from services.simulator.device import MODULE, upload

REACH = 0.004
"""Distance up to which the plate's distance is exact; farther away it is only known to be far [m]."""

FAR = wp.constant(1.0)
BOX_ROUNDING = wp.constant(ROUNDING)
PLATE_REACH = wp.constant(REACH)
BIN = 0.001
TABLE_EDGE = 10.0


def upload_plate(plate: Plate, device: str) -> Plates:
    """Return the plate's profile with its tables; the last height continues as the table [m]."""
    radii = np.append(plate.radii, max(TABLE_EDGE, 2 * plate.radii[-1]))
    heights = np.append(plate.heights, plate.heights[-1])
    bins = int(np.ceil((plate.radii[-1] + 2 * REACH) / BIN)) + 1
    low = np.arange(bins) * BIN - REACH
    high = low + BIN + 2 * REACH
    first = np.clip(np.searchsorted(radii, np.maximum(low, 0), side="right") - 1, 0, len(radii) - 2)
    ceiling = np.maximum(np.interp(np.maximum(low, 0), radii, heights), np.interp(high, radii, heights))
    for index, (inner, outer) in enumerate(zip(low, high, strict=True)):
        within = heights[(radii >= inner) & (radii <= outer)]
        ceiling[index] = max(ceiling[index], *within, -np.inf)
    ceiling[-1] = max(ceiling[-1], heights[-1])
    tables = Plates()
    tables.radii = upload(radii, float, device)
    tables.heights = upload(heights, float, device)
    tables.bin = BIN
    tables.first = upload(first, int, device)
    tables.ceiling = upload(ceiling, float, device)
    return tables


@wp.func(module=MODULE)
def plate_distance(plate: Plates, point: wp.vec3):
    """Return outward normal and signed distance to the surface of revolution (x, y, z, distance)."""
    r = wp.sqrt(point[0] * point[0] + point[1] * point[1])
    ring = wp.min(int(r / plate.bin), plate.ceiling.shape[0] - 1)
    if point[2] > plate.ceiling[ring] + PLATE_REACH:
        return wp.vec4(0.0, 0.0, 1.0, FAR)
    best = float(1.0e6)
    normal_r = float(0.0)
    normal_z = float(1.0)
    below = float(1.0)
    vertex = int(0)
    segment = plate.first[ring]
    while segment < plate.radii.shape[0] - 1 and plate.radii[segment] < r + PLATE_REACH:
        dr = plate.radii[segment + 1] - plate.radii[segment]
        dz = plate.heights[segment + 1] - plate.heights[segment]
        length = wp.sqrt(dr * dr + dz * dz)
        pr = r - plate.radii[segment]
        pz = point[2] - plate.heights[segment]
        along = (pr * dr + pz * dz) / length
        across = (pz * dr - pr * dz) / length
        if pr >= 0.0 and pr < dr and across < 0.0:
            below = -1.0
        if along >= 0.0 and along <= length:
            if wp.abs(across) < best:
                best = wp.abs(across)
                normal_r = -dz / length
                normal_z = dr / length
                vertex = 0
        else:
            if along > length:
                pr = pr - dr
                pz = pz - dz
            distance = wp.sqrt(pr * pr + pz * pz)
            if distance < best and distance > 1.0e-7:
                best = distance
                normal_r = pr / distance
                normal_z = pz / distance
                vertex = 1
        segment += 1
    if vertex == 1:
        normal_r = below * normal_r
        normal_z = below * normal_z
    inverse = float(0.0)
    if r > 1.0e-9:
        inverse = 1.0 / r
    return wp.vec4(normal_r * point[0] * inverse, normal_r * point[1] * inverse, normal_z, below * best)


@wp.func(module=MODULE)
def box_distance(core: wp.vec3, point: wp.vec3):
    """Return outward normal and signed distance to a rounded box in its frame (x, y, z, distance)."""
    ex = wp.abs(point[0]) - core[0]
    ey = wp.abs(point[1]) - core[1]
    ez = wp.abs(point[2]) - core[2]
    normal = wp.vec3(wp.max(ex, 0.0), wp.max(ey, 0.0), wp.max(ez, 0.0))
    distance = wp.length(normal)
    if distance > 1.0e-7:
        normal = normal / distance
    else:
        distance = wp.max(ex, wp.max(ey, ez))
        if distance == ex:
            normal = wp.vec3(1.0, 0.0, 0.0)
        elif distance == ey:
            normal = wp.vec3(0.0, 1.0, 0.0)
        else:
            normal = wp.vec3(0.0, 0.0, 1.0)
    return wp.vec4(
        wp.sign(point[0]) * normal[0],
        wp.sign(point[1]) * normal[1],
        wp.sign(point[2]) * normal[2],
        distance - BOX_ROUNDING,
    )
