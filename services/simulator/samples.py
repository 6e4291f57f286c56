"""Points of the bodies' surfaces at which contact is felt."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from common.domain.bodies import ROUNDING, Box
from services.simulator.mesh import Mesh
from services.simulator.outline import Outline
from services.simulator.settings import Settings

BOTTOM, SIDE, TOP = 0, 1, 2
"""What a sample feels: plate, tray and boxes; plate and boxes; boxes only."""

TOP_SAMPLES = 3
"""Samples along each edge of a cell's top face, where only a fallen fry can touch."""

PATCH_LENGTH = 0.012
"""Largest extent of a group of samples on a box's edge [m]."""


@dataclass(frozen=True)
class Samples:
    """Contact samples of one body, sorted by patch.

    Attributes:
        points: Positions in the body's frame ``(S, 3)`` [m].
        radius: Radius of the sphere around each point [m] ``(S,)``.
        stiffness: Normal stiffness ``(S,)`` [N/m].
        kind: `BOTTOM`, `SIDE` or `TOP` ``(S,)``.
        patch: Group of neighbours that each belongs to ``(S,)``.
    """

    points: NDArray[np.float64]
    radius: NDArray[np.float64]
    stiffness: NDArray[np.float64]
    kind: NDArray[np.int32]
    patch: NDArray[np.int32]


def item_samples(outline: Outline, mesh: Mesh, settings: Settings) -> Samples:
    """Spread samples over an item: the underside, its outline at several heights, and sparsely the top.

    A patch is a hexahedron of the mesh.
    """
    area = float(mesh.spacing.prod())
    bottom = _face_points(outline, mesh, settings.samples)
    top = _face_points(outline, mesh, TOP_SAMPLES)
    rows, columns, _ = outline.locate(top)
    boundary = outline.boundary
    rim = outline.corner + boundary[:, ::-1] * outline.pixel
    thickness = outline.lattice[boundary[:, 0], boundary[:, 1]]
    levels = np.linspace(0, 1, mesh.layers + 1)
    wall = np.concatenate([np.column_stack([rim, thickness * level]) for level in levels])
    points = np.concatenate(
        [
            np.column_stack([bottom, np.zeros(len(bottom))]),
            wall,
            np.column_stack([top, outline.thickness[rows, columns]]),
        ]
    )
    sample_area = area / settings.samples**2
    stiffness = settings.normal_stiffness * np.concatenate(
        [
            np.full(len(bottom) + len(wall), sample_area),
            np.full(len(top), area / TOP_SAMPLES**2),
        ]
    )
    kind = np.concatenate(
        [
            np.full(len(bottom), BOTTOM),
            np.repeat(np.where(levels == 0, BOTTOM, SIDE), len(rim)),
            np.full(len(top), TOP),
        ]
    )
    patch = mesh.embed(points)[0]
    order = np.argsort(patch, kind="stable")
    return Samples(points[order], np.zeros(len(points)), stiffness[order], kind[order].astype(np.int32), patch[order])


def box_samples(box: Box, settings: Settings) -> Samples:
    """Spread spheres of radius `ROUNDING` along the twelve edges of the box's core."""
    core = box.size / 2 - ROUNDING
    points: list[NDArray[np.float64]] = []
    patches: list[NDArray[np.int32]] = []
    patch = 0
    for axis in range(3):
        count = max(int(np.ceil(2 * core[axis] / settings.box_spacing)) + 1, 2)
        along = np.linspace(-core[axis], core[axis], count)
        if axis != int(np.argmax(core)):
            along = along[1:-1]  # the corners belong to the longest edges
        groups = max(int(np.ceil(2 * core[axis] / PATCH_LENGTH)), 1)
        group = np.minimum((np.arange(len(along)) * groups) // max(len(along), 1), groups - 1)
        for first, second in ((-1, -1), (1, -1), (1, 1), (-1, 1)):
            edge = np.empty((len(along), 3))
            edge[:, axis] = along
            edge[:, (axis + 1) % 3] = first * core[(axis + 1) % 3]
            edge[:, (axis + 2) % 3] = second * core[(axis + 2) % 3]
            points.append(edge)
            patches.append((patch + group).astype(np.int32))
            patch += groups
    positions = np.concatenate(points)
    return Samples(
        positions,
        np.full(len(positions), ROUNDING),
        np.full(len(positions), settings.point_stiffness),
        np.full(len(positions), SIDE, dtype=np.int32),
        np.unique(np.concatenate(patches), return_inverse=True)[1].astype(np.int32),
    )


def _face_points(outline: Outline, mesh: Mesh, count: int) -> NDArray[np.float64]:
    """Return ``count`` x ``count`` points in each lattice cell, those that the item covers ``(P, 2)`` [m]."""
    fractions = (np.arange(count) + 0.5) / count
    shape = mesh.columns.shape
    lattice = np.stack(
        np.meshgrid(*((np.arange(edge)[:, None] + fractions).ravel() for edge in shape), indexing="ij"), axis=-1
    ).reshape(-1, 2)
    points = mesh.origin + (lattice * mesh.spacing) @ mesh.axes
    return points[outline.locate(points)[2]]
