"""Rigid bodies for the kernels: mass, inertia and samples of boxes and of a rigid item."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from common.domain.bodies import ROUNDING, Box
from services.simulator.mesh import Mesh
from services.simulator.outline import Outline
from services.simulator.samples import Samples, box_samples, item_samples
from services.simulator.settings import Settings


@dataclass(frozen=True)
class Body:
    """One rigid body.

    Attributes:
        mass: [kg].
        inertia: About the centre of mass, in the body's frame ``(3, 3)`` [kg m2].
        centre: Centre of mass in the frame in which the samples were made ``(3,)`` [m].
        core: Half edges less the rounding of a box ``(3,)`` [m]; zeros for other bodies.
        samples: Contact samples, relative to the centre of mass.
        reach: Radius of a sphere around the body [m].
    """

    mass: float
    inertia: NDArray[np.float64]
    centre: NDArray[np.float64]
    core: NDArray[np.float64]
    samples: Samples
    reach: float


def box_body(box: Box, settings: Settings) -> Body:
    """Return the rigid body of a box; its mass is that of the unrounded box."""
    mass = box.material.density * float(box.size.prod())
    squares = box.size**2
    inertia = np.diag(mass / 12 * (squares.sum() - squares))
    reach = float(np.linalg.norm(box.size / 2))
    return Body(mass, inertia, np.zeros(3), box.size / 2 - ROUNDING, box_samples(box, settings), reach)


def item_body(outline: Outline, mesh: Mesh, settings: Settings) -> Body:
    """Return the rigid body of an item: every pixel of its heightmap is a column of its density."""
    rows, columns = np.nonzero(outline.covered)
    height = outline.thickness[rows, columns]
    masses = outline.materials[0][rows, columns] * height * outline.pixel**2
    middles = np.column_stack([outline.centres, height / 2])
    mass = float(masses.sum())
    centre = (masses[:, None] * middles).sum(axis=0) / mass
    offset = middles - centre
    own = np.stack([np.full_like(height, outline.pixel**2), np.full_like(height, outline.pixel**2), height**2], axis=1)
    second = np.einsum("p,pi,pj->ij", masses, offset, offset) + np.diag((masses[:, None] * own).sum(axis=0) / 12)
    inertia = np.eye(3) * np.trace(second) - second
    samples = item_samples(outline, mesh, settings)
    points = samples.points - centre
    samples = Samples(
        points,
        samples.radius,
        np.full(len(points), settings.point_stiffness),
        samples.kind,
        np.unique(samples.patch, return_inverse=True)[1].astype(np.int32),
    )
    return Body(mass, inertia, centre, np.zeros(3), samples, float(np.linalg.norm(points, axis=1).max()))


def patch_spheres(bodies: Sequence[Body]) -> tuple[NDArray[np.int32], NDArray[np.float64], NDArray[np.float64]]:
    """Return body ``(P,)``, centre ``(P, 3)`` and radius ``(P,)`` [m] of the sphere around every patch of samples."""
    owners: list[int] = []
    centres: list[NDArray[np.float64]] = []
    radii: list[float] = []
    for index, body in enumerate(bodies):
        for patch in range(int(body.samples.patch.max()) + 1):
            members = body.samples.patch == patch
            points = body.samples.points[members]
            centre = (points.min(axis=0) + points.max(axis=0)) / 2
            owners.append(index)
            centres.append(centre)
            radii.append(float(np.linalg.norm(points - centre, axis=1).max() + body.samples.radius[members].max()))
    return np.array(owners, dtype=np.int32), np.array(centres).reshape(-1, 3), np.array(radii)
