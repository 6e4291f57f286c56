"""How deep bodies sink into each other: the price of contact by springs."""

import numpy as np
from numpy.typing import NDArray

from common.domain.bodies import ROUNDING, Box, Material
from services.simulator.placement import Placement
from services.simulator.samples import TOP, box_samples, item_samples
from services.simulator.simulation import Outcome

_ANY = Material(1.0, 1.0, 0.0)


def deepest_penetration(placement: Placement, outcome: Outcome, world: int = 0) -> float:
    """Return the largest depth of a surface point in plate or box [m]; against the plate it is measured along z.

    The points are the contact samples of item and boxes, corners and edges included; the distances are computed in
    double precision and apart from the kernels.
    """
    first = int(placement.item is not None)
    boxes = [
        Box(box.size, outcome.positions[world, first + i], outcome.orientations[world, first + i], box.material)
        for i, box in enumerate(placement.boxes)
    ]
    surfaces = [(_item_points(placement, outcome, world), 0.0, -1)]
    for index, box in enumerate(boxes):
        points = box.position + box_samples(box, placement.settings).points @ box.rotation.T
        surfaces.append((points, ROUNDING, index))
    deepest = 0.0
    for points, radius, own in surfaces:
        ground = placement.plate.height(np.hypot(points[:, 0], points[:, 1]))
        deepest = max(deepest, float((ground - points[:, 2]).max()) + radius)
        for index, box in enumerate(boxes):
            if index != own:
                deepest = max(deepest, radius - float(distance_to_box(box, points).min()))
    return deepest


def _item_points(placement: Placement, outcome: Outcome, world: int) -> NDArray[np.float64]:
    """Return the item's samples that can touch plate or boxes from above ``(S, 3)`` [m]."""
    if placement.item is not None:
        samples = placement.item.samples
        pose = Box(np.ones(3), outcome.positions[world, 0], outcome.orientations[world, 0], _ANY)
        return pose.position + samples.points[samples.kind != TOP] @ pose.rotation.T
    samples = item_samples(placement.outline, placement.mesh, placement.settings)
    cells, weights = placement.mesh.embed(samples.points[samples.kind != TOP])
    return (weights[:, :, None] * outcome.nodes[world][placement.mesh.cells[cells]]).sum(axis=1)


def distance_to_box(box: Box, points: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return signed distances from points ``(S, 3)`` to a rounded box ``(S,)`` [m]."""
    excess = np.abs((points - box.position) @ box.rotation) - (box.size / 2 - ROUNDING)
    return np.linalg.norm(np.maximum(excess, 0), axis=1) + np.minimum(excess.max(axis=1), 0) - ROUNDING
