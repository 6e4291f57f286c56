"""What rests on what: the upper faces are seen, the lower ones follow from what carries them."""

import numpy as np

from common.domain.bodies import Plate
from services.simulator.perception_boxes import Array, axes, soft_tops

THINNEST, THICKEST = 0.8, 1.2
"""Thickness that a box may have, as a multiple of its width [-]."""
INSET = 0.45
"""Share of the edges within which a box is carried: what reaches less far under it lies beside it [-]."""


def rest_thicknesses(boxes: Array, plate: Plate) -> Array:
    """Return the thickness ``(K,)`` [m] with which each box just touches the highest thing that carries it.

    A box that would have to be much thicker or thinner than wide keeps a square section.
    """
    frame = axes(boxes)
    along, across = np.meshgrid(np.linspace(-INSET, INSET, 31), np.linspace(-INSET, INSET, 5))
    lattice = np.stack([along.ravel(), across.ravel()], axis=1)
    thicknesses = boxes[:, 7].copy()
    for index, box in enumerate(boxes):
        up, width = frame[index, 2], box[7]
        face = box[:3] + (lattice * box[6:]) @ frame[index, :2]
        below = face - up * width
        ground = plate.height(np.hypot(below[:, 0], below[:, 1]))
        carriers = soft_tops(np.delete(boxes, index, axis=0), below[:, :2], ground, 1e-4)
        gaps = (face[:, 2] - np.vstack([ground, carriers])) * up[2]
        gaps = gaps[(gaps > THINNEST * width) & (gaps < THICKEST * width)]
        thicknesses[index] = gaps.min(initial=THICKEST * width) if len(gaps) else width
    return thicknesses
