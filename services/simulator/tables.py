# pyright: reportGeneralTypeIssues=false
# A Warp struct is an object to a checker of Python, not a class.
"""What does not change during a run, uploaded: laws, soft item, rigid bodies."""

from collections.abc import Sequence
from typing import Any

import numpy as np
import warp as wp
from numpy.typing import NDArray

from services.simulator.arrays import Laws, Rigid, Solid
from services.simulator.bodies import Body, patch_spheres
from services.simulator.device import upload
from services.simulator.mesh import Mesh
from services.simulator.samples import Samples
from services.simulator.settings import Settings
from services.simulator.stiffness import centre_gradients, hexahedron_stiffness


def laws_of(settings: Settings, gravity: tuple[float, float, float], undamped: bool) -> Laws:
    """Return settings as the kernels see them; ``undamped`` keeps all velocity and never stops at rest."""
    laws = Laws()
    laws.friction = settings.friction
    laws.stick_ratio = settings.stick_ratio
    laws.softening = settings.softening
    laws.tray_patience = settings.tray_patience
    laws.patience = settings.patience
    laws.gravity = wp.vec3(*gravity)
    laws.keep_fast = 1.0 if undamped else settings.keep_fast
    laws.keep_slow = 1.0 if undamped else settings.keep_slow
    laws.slow = settings.slow
    laws.first_step = settings.first_step
    laws.longest_step = settings.first_step if undamped else settings.longest_step
    laws.shortest_step = settings.shortest_step
    laws.iterations = settings.iterations
    laws.tolerance = settings.tolerance
    laws.relative_tolerance = settings.relative_tolerance
    laws.tray_speed = settings.tray_speed
    laws.rest_displacement = settings.rest_displacement
    laws.longest_time = settings.longest_time
    laws.stops_at_rest = 0 if undamped else 1
    return laws


def solid_of(mesh: Mesh | None, samples: Samples | None, pinned: NDArray[np.bool_] | None, device: str) -> Solid:
    """Upload a soft item: stiffness and mass of its mesh, contact samples; without one, arrays that nothing reads."""
    solid = Solid()
    if mesh is None or samples is None:
        for name, dtype, ndim in (
            ("cells", int, 2),
            ("rest", wp.vec3, 2),
            ("gradient", wp.vec3, 2),
            ("stiffness", wp.mat33, 2),
            ("mass", float, 1),
            ("pinned", float, 1),
            ("first_sample", int, 1),
            ("patch", int, 1),
            ("kind", int, 1),
            ("normal_stiffness", float, 1),
            ("corners", int, 1),
            ("weights", float, 2),
        ):
            setattr(solid, name, wp.zeros((1,) * ndim, dtype=dtype, device=device))
        return solid
    corners = mesh.corners
    stiffness = hexahedron_stiffness(corners, mesh.materials[1] * mesh.fill, mesh.materials[2])
    blocks = stiffness.reshape(-1, 8, 3, 8, 3).transpose(0, 1, 3, 2, 4).reshape(-1, 64, 3, 3)
    patch, weights = mesh.embed(samples.points)
    solid.cells = upload(mesh.cells, int, device)
    solid.rest = upload(corners - corners[:, :1], wp.vec3, device)
    solid.gradient = upload(centre_gradients(corners), wp.vec3, device)
    solid.stiffness = upload(blocks, wp.mat33, device)
    solid.mass = upload(mesh.masses, float, device)
    solid.pinned = upload(np.zeros(len(mesh.positions)) if pinned is None else pinned.astype(float), float, device)
    solid.patch = upload(patch, int, device)
    solid.first_sample = upload(np.searchsorted(patch, np.arange(len(mesh.cells) + 1)), int, device)
    solid.kind = upload(samples.kind, int, device)
    solid.normal_stiffness = upload(samples.stiffness, float, device)
    solid.corners = upload(np.where((weights[:, 4:] == 0).all(axis=1), 4, 8), int, device)
    solid.weights = upload(weights, float, device)
    return solid


def rigid_of(bodies: Sequence[Body], rigid_item: bool, first_patch: int, device: str) -> Rigid:
    """Upload rigid bodies, the item first if it is rigid; their patches are numbered from ``first_patch``."""
    rigid = Rigid()
    rigid.bodies = len(bodies)
    rigid.first_box = int(rigid_item)
    rigid.boxes = len(bodies) - int(rigid_item)
    rigid.first_patch = first_patch
    owner, centre, radius = patch_spheres(bodies)
    patches = np.cumsum([0, *(int(body.samples.patch.max()) + 1 for body in bodies)])
    samples = [body.samples for body in bodies]

    def joined(values: list[NDArray[Any]]) -> NDArray[Any]:
        return np.concatenate(values) if values else np.zeros(0)

    rigid.mass = upload(np.array([body.mass for body in bodies]), float, device)
    rigid.inertia = upload(np.array([body.inertia for body in bodies]).reshape(-1, 3, 3), wp.mat33, device)
    rigid.core = upload(np.array([body.core for body in bodies]).reshape(-1, 3), wp.vec3, device)
    rigid.reach = upload(np.array([body.reach for body in bodies]), float, device)
    rigid.body = upload(joined([np.full(len(part.points), index) for index, part in enumerate(samples)]), int, device)
    rigid.point = upload(joined([part.points for part in samples]).reshape(-1, 3), wp.vec3, device)
    rigid.radius = upload(joined([part.radius for part in samples]), float, device)
    rigid.kind = upload(joined([part.kind for part in samples]), int, device)
    rigid.normal_stiffness = upload(joined([part.stiffness for part in samples]), float, device)
    numbered = joined([part.patch + start for part, start in zip(samples, patches, strict=False)])
    rigid.first_sample = upload(np.searchsorted(numbered, np.arange(patches[-1] + 1)), int, device)
    rigid.patch_body = upload(owner, int, device)
    rigid.patch_centre = upload(centre, wp.vec3, device)
    rigid.patch_radius = upload(radius, float, device)
    return rigid
