"""Vertical cross-sections of a placement: the deformed item, the boxes and the plate in one plane."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from common.domain.bodies import Box, Material
from services.simulator.penetration import distance_to_box
from services.simulator.placement import Placement
from services.simulator.simulation import Outcome

STEP = 5e-4
"""Spacing of a section's points [m]."""

_ANY = Material(1.0, 1.0, 0.0)


@dataclass(frozen=True)
class Section:
    """What a vertical plane through the action cuts.

    Attributes:
        along: Distance from the action in the plane ``(U,)`` [m].
        height: Height above the plate's flat ``(Z,)`` [m].
        ground: Height of the plate ``(U,)`` [m].
        boxes: Signed distance to the nearest box, negative inside ``(Z, U)`` [m].
        item: Material lines of the item, underside first: distance and height ``(L, P, 2)`` [m]; they lie in the plane
            before the item deforms, and are projected on it.
    """

    along: NDArray[np.float64]
    height: NDArray[np.float64]
    ground: NDArray[np.float64]
    boxes: NDArray[np.float64]
    item: NDArray[np.float64]


def cut(
    placement: Placement,
    outcome: Outcome,
    action: NDArray[np.float64],
    *,
    half_width: float = 0.11,
    top: float = 0.07,
    world: int = 0,
) -> Section:
    """Cut one world along the item's longer axis, towards increasing x.

    Args:
        placement: The state that was simulated.
        outcome: Where everything is.
        action: Where the item was placed ``(2,)`` [m].
        half_width: Half of the section's width [m].
        top: Height of the section [m].
        world: Which of the placement's worlds.
    """
    direction = placement.mesh.axes[0] * (1 if placement.mesh.axes[0, 0] >= 0 else -1)
    along = np.arange(-half_width, half_width + STEP / 2, STEP)
    height = np.arange(-0.006, top + STEP / 2, STEP)
    plane = action + along[:, None] * direction
    z, index = np.meshgrid(height, np.arange(len(along)), indexing="ij")
    points = np.column_stack([plane[index.ravel()], z.ravel()])
    boxes = np.full(len(points), np.inf)
    for box in boxes_of(placement, outcome, world=world):
        boxes = np.minimum(boxes, distance_to_box(box, points))
    return Section(
        along=along,
        height=height,
        ground=placement.plate.height(np.hypot(*plane.T)),
        boxes=boxes.reshape(z.shape),
        item=_item_lines(placement, outcome, action, direction, along, world),
    )


def boxes_of(placement: Placement, outcome: Outcome, *, world: int = 0) -> list[Box]:
    """Return the boxes where they are in one world."""
    first = int(placement.item is not None)
    poses = zip(outcome.positions[world, first:], outcome.orientations[world, first:], strict=True)
    return [
        Box(box.size, position, turn, box.material)
        for box, (position, turn) in zip(placement.boxes, poses, strict=True)
    ]


def _item_lines(
    placement: Placement,
    outcome: Outcome,
    action: NDArray[np.float64],
    direction: NDArray[np.float64],
    along: NDArray[np.float64],
    world: int,
) -> NDArray[np.float64]:
    flat = along[:, None] * direction
    rows, columns, covered = placement.outline.locate(flat)
    flat, thickness = flat[covered], placement.outline.thickness[rows, columns][covered]
    lines = []
    for share in np.linspace(0, 1, placement.mesh.layers + 1):
        points = np.column_stack([flat, share * thickness])
        if placement.item is not None:
            pose = Box(np.ones(3), outcome.positions[world, 0], outcome.orientations[world, 0], _ANY)
            points = pose.position + (points - placement.item.centre) @ pose.rotation.T
        else:
            cells, weights = placement.mesh.embed(points)
            points = (weights[:, :, None] * outcome.nodes[world][placement.mesh.cells[cells]]).sum(axis=1)
        lines.append(np.column_stack([(points[:, :2] - action) @ direction, points[:, 2]]))
    return np.array(lines)
