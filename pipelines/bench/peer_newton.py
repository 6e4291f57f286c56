# pyright: reportMissingImports=false, reportArgumentType=false
# The package is optional, and its aliases of types are not Warp's.
"""Newton's vertex block descent (``newton.solvers.SolverVBD``) on the scene of the peers.

Linear tetrahedra, stable neo-Hookean, penalty contact on the item's whole surface, sharp boxes.
"""

from dataclasses import dataclass

import newton
import numpy as np
import warp as wp
from numpy.typing import NDArray

from pipelines.bench.peer import Peer
from pipelines.bench.peer_scene import FRICTION, START_SPEED, STEAK, PeerScene

CONTACT_STIFFNESS = 1e4
CONTACT_GAP = 0.004
PARTICLE_RADIUS = 1e-4
DAMPING = 50.0


@dataclass(frozen=True)
class NewtonSettings:
    """Time step [s] and iterations a step of one run."""

    step_s: float
    iterations: int


NEWTON_SETTINGS = (
    NewtonSettings(0.002, 10),
    NewtonSettings(0.002, 15),
    NewtonSettings(0.002, 20),
    NewtonSettings(0.002, 40),
)
"""From cheap to dear; the first that agrees counts."""


class NewtonPeer(Peer):
    """Newton's VBD solver, item and fries together; its kernels are compiled before the first step counts."""

    name = f"Newton {newton.__version__} SolverVBD"

    def __init__(self, scene: PeerScene, chosen: NewtonSettings) -> None:
        self.step_s = chosen.step_s
        self.settings = {
            "step_s": chosen.step_s,
            "iterations": chosen.iterations,
            "contact_stiffness_n_per_m": CONTACT_STIFFNESS,
            "damping_pa_s": DAMPING,
            "full_surface_contact": True,
        }
        self._shape = scene.nodes.shape
        model = _build(scene)
        self._pipeline = newton.CollisionPipeline(
            model, soft_contact_gap=CONTACT_GAP, enable_rigid_soft_full_surface_contact=True
        )
        self._contacts = self._pipeline.contacts()
        self._solver = newton.solvers.SolverVBD(
            model,
            iterations=chosen.iterations,
            particle_enable_self_contact=False,
            particle_enable_tile_solve=False,
        )
        self._control = model.control()
        self._now, self._next = model.state(), model.state()
        self.advance()  # compiles; then start again
        self._now, self._next = model.state(), model.state()

    def advance(self) -> None:
        """Find contacts and take one implicit step."""
        self._now.clear_forces()
        self._pipeline.collide(self._now, self._contacts)
        self._solver.step(self._now, self._next, self._control, self._contacts, self.step_s)
        self._now, self._next = self._next, self._now

    def nodes(self) -> NDArray[np.float64]:
        """Return where the particles are ``(I, J, L, 3)`` [m]."""
        assert self._now.particle_q is not None
        return self._now.particle_q.numpy().astype(np.float64).reshape(self._shape)


def _build(scene: PeerScene) -> newton.Model:
    builder = newton.ModelBuilder()
    surface = newton.ModelBuilder.ShapeConfig(
        density=scene.boxes[0].material.density, ke=CONTACT_STIFFNESS, kd=1.0, mu=FRICTION
    )
    builder.add_ground_plane(cfg=surface)
    for box in scene.boxes:
        body = builder.add_body(xform=wp.transform(wp.vec3(*box.position), wp.quat(*box.orientation)))
        half = box.size / 2
        builder.add_shape_box(body, hx=half[0], hy=half[1], hz=half[2], cfg=surface)
    modulus, poisson = STEAK.youngs_modulus, STEAK.poisson_ratio
    builder.add_soft_mesh(
        pos=wp.vec3(0.0, 0.0, 0.0),
        rot=wp.quat_identity(),
        scale=1.0,
        vel=wp.vec3(0.0, 0.0, -START_SPEED),
        vertices=[wp.vec3(*node) for node in scene.nodes.reshape(-1, 3)],
        indices=scene.tetrahedra.ravel().tolist(),
        density=STEAK.density,
        k_mu=modulus / (2 * (1 + poisson)),
        k_lambda=modulus * poisson / ((1 + poisson) * (1 - 2 * poisson)),
        k_damp=DAMPING,
        particle_radius=PARTICLE_RADIUS,
    )
    builder.color()
    model = builder.finalize(device="cpu")
    model.soft_contact_ke = CONTACT_STIFFNESS
    model.soft_contact_kd = 1e-3 * CONTACT_STIFFNESS
    model.soft_contact_mu = FRICTION
    return model
