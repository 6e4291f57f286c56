# pyright: reportGeneralTypeIssues=false
# A Warp struct is an object to a checker of Python, not a class.
"""Worlds on a device: build their arrays, run them to rest, read them back."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import warp as wp
from numpy.typing import NDArray

from common.domain.bodies import Plate
from services.simulator import contact, elements, memory, raster, stepping
from services.simulator.arrays import DONE, ENDED, FIRST_BOX, START, Laws, System, Worlds
from services.simulator.bodies import Body
from services.simulator.mesh import Mesh
from services.simulator.samples import Samples
from services.simulator.settings import Settings
from services.simulator.surfaces import upload_plate
from services.simulator.system import PADDING, VECTOR, solve_newton
from services.simulator.tables import laws_of, rigid_of, solid_of

KERNELS = (contact, elements, memory, raster, stepping)
"""Every module with kernels: the Warp module must be complete before it is first compiled."""

NO_TRAY = -1e3


@dataclass(frozen=True)
class Outcome:
    """How a run ended, one entry a world.

    Attributes:
        nodes: Positions of the soft item's nodes ``(W, N, 3)`` [m].
        positions: Centres of the rigid bodies ``(W, M, 3)`` [m].
        orientations: Their quaternions, scalar last ``(W, M, 4)``.
        speed: Largest speed in the last step ``(W,)`` [m/s].
        settled: Whether everything is at rest ``(W,)``.
        time: Simulated time ``(W,)`` [s].
        ticks: Evaluations of the forces.
    """

    nodes: NDArray[np.float32]
    positions: NDArray[np.float32]
    orientations: NDArray[np.float32]
    speed: NDArray[np.float32]
    settled: NDArray[np.bool_]
    time: NDArray[np.float32]
    ticks: int


class Simulation:
    """Any number of worlds that share one item, one plate and one set of boxes.

    Worlds differ in where the item starts. All memory is allocated here, `run` only launches kernels.
    """

    def __init__(
        self,
        *,
        plate: Plate,
        mesh: Mesh | None,
        samples: Samples | None,
        bodies: Sequence[Body],
        rigid_item: bool = False,
        worlds: int = 1,
        settings: Settings,
        device: str = "cpu",
        gravity: tuple[float, float, float] = (0.0, 0.0, -9.81),
        pinned: NDArray[np.bool_] | None = None,
        undamped: bool = False,
    ) -> None:
        self.device = device
        self.count = worlds
        self.nodes = len(mesh.positions) if mesh else 0
        self.bodies = len(bodies)
        self.plate = upload_plate(plate, device)
        self._settings = settings
        self._gravity = gravity
        self.laws = laws_of(settings, gravity, undamped)
        self.solid = solid_of(mesh, samples, pinned, device)
        self.rigid = rigid_of(bodies, rigid_item, len(mesh.cells) if mesh else 0, device)
        self.worlds = self._allocate(len(mesh.cells) if mesh else 0, len(samples.points) if samples else 0)
        self.system = self._allocate_system(mesh)
        self._cells = len(mesh.cells) if mesh else 0
        self._patches = self.rigid.patch_body.shape[0] if bodies else 0
        self._launches = self._record(self.laws)

    def place(
        self,
        nodes: NDArray[np.float64],
        positions: NDArray[np.float64],
        orientations: NDArray[np.float64],
        *,
        tray: NDArray[np.float64] | None = None,
        item_velocity: float = 0.0,
    ) -> None:
        """Start all worlds anew.

        Args:
            nodes: ``(W, N, 3)`` [m].
            positions: Centres of the bodies ``(W, M, 3)`` [m].
            orientations: ``(W, M, 4)``.
            tray: Height of the tray in each world ``(W,)`` [m]; without it there is none.
            item_velocity: Vertical velocity of the item [m/s].
        """
        worlds = self.worlds
        for array in (worlds.x0, worlds.xb, worlds.x):
            if self.nodes:
                array.assign(nodes.astype(np.float32))
        for array in (worlds.p0, worlds.pb, worlds.p):
            if self.bodies:
                array.assign(positions.astype(np.float32))
        for array in (worlds.q0, worlds.qb, worlds.q):
            if self.bodies:
                array.assign(orientations.astype(np.float32))
        for name in (
            "v",
            "f",
            "d",
            "pv",
            "qv",
            "pf",
            "qf",
            "pd",
            "qd",
            "near",
            "touched",
            "body_touched",
            "time",
            "calm",
            "moved",
        ):
            getattr(worlds, name).zero_()
        for name in ("anchor", "grip", "body_anchor", "iteration", "trials", "tray_load", "idle", "converged"):
            getattr(worlds, name).zero_()
        if self.nodes:
            worlds.v.fill_(wp.vec3(0.0, 0.0, item_velocity))
        elif self.rigid.first_box:
            velocities = np.zeros((self.count, self.bodies, 3), dtype=np.float32)
            velocities[:, 0, 2] = item_velocity
            worlds.pv.assign(velocities)
        worlds.dt.fill_(self.laws.first_step)
        worlds.fresh.fill_(1)
        worlds.tray_on.fill_(int(tray is not None))
        worlds.tray.assign(np.full(self.count, NO_TRAY) if tray is None else tray.astype(np.float32))
        worlds.phase.fill_(int(ENDED))

    def run(self, *, check: Callable[[], None] | None = None) -> Outcome:
        """Advance all worlds until each is at rest or out of time.

        Args:
            check: Called now and then; what it raises ends the run (a cancelled request, say).
        """
        ticks = 0
        while True:
            for launch in self._launches:
                launch.launch()
            ticks += 1
            if (self.worlds.phase.numpy() == int(DONE)).all():
                break
            if check is not None and ticks % 4 == 0:
                check()
        return self.read(ticks)

    def verify_rest(self, *, duration: float = 0.2, step: float = 0.005) -> NDArray[np.float32]:
        """Return the largest speed of each world ``(W,)`` [m/s] while it goes on without damping, from where it is.

        What had stopped at an unstable place, or only because of the damping, starts to move.
        """
        worlds = self.worlds
        strict = replace(
            self._settings,
            first_step=step,
            shortest_step=step,
            longest_time=duration,
            iterations=20,
            tolerance=1e-7,
            relative_tolerance=1e-3,
        )
        laws = laws_of(strict, self._gravity, undamped=True)
        worlds.time.zero_()
        worlds.dt.fill_(step)
        worlds.phase.fill_(int(START))
        launches = self._record(laws)
        fastest = np.zeros(self.count, dtype=np.float32)
        while (worlds.phase.numpy() != int(DONE)).any():
            for launch in launches:
                launch.launch()
            fastest = np.maximum(fastest, np.where(worlds.time.numpy() > 0, worlds.speed.numpy(), 0))
        return fastest

    def read(self, ticks: int = 0) -> Outcome:
        """Return copies of where everything is."""
        worlds = self.worlds
        return Outcome(
            nodes=worlds.x0.numpy()[:, : self.nodes].copy(),
            positions=worlds.p0.numpy()[:, : self.bodies].copy(),
            orientations=worlds.q0.numpy()[:, : self.bodies].copy(),
            speed=worlds.speed.numpy().copy(),
            settled=worlds.calm.numpy() >= 2,
            time=worlds.time.numpy().copy(),
            ticks=ticks,
        )

    def _allocate(self, cells: int, samples: int) -> Worlds:
        count, device = self.count, self.device
        nodes, bodies = max(self.nodes, 1), max(self.bodies, 1)
        points = self.rigid.point.shape[0]
        obstacles = int(FIRST_BOX) + self.rigid.boxes
        worlds = Worlds()
        for name in ("x0", "xb", "x", "v", "f", "d"):
            setattr(worlds, name, wp.zeros((count, nodes), dtype=wp.vec3, device=device))
        for name in ("p0", "pb", "p", "pv", "qv", "pf", "qf", "pd", "qd"):
            setattr(worlds, name, wp.zeros((count, bodies), dtype=wp.vec3, device=device))
        for name in ("q0", "qb", "q"):
            setattr(worlds, name, wp.zeros((count, bodies), dtype=wp.quat, device=device))
        worlds.turn = wp.zeros((count, max(cells, 1)), dtype=wp.mat33, device=device)
        patches = cells + self.rigid.patch_body.shape[0]
        for name in ("near", "was_near"):
            setattr(worlds, name, wp.zeros((count, patches), dtype=int, device=device))
        worlds.touched = wp.zeros((count, max(samples, 1)), dtype=int, device=device)
        worlds.body_touched = wp.zeros((count, points), dtype=int, device=device)
        worlds.anchor = wp.zeros((count, max(samples, 1), obstacles), dtype=wp.vec3, device=device)
        for name in ("grip", "body_anchor"):
            setattr(worlds, name, wp.zeros((count, points, obstacles), dtype=wp.vec3, device=device))
        for name in ("phase", "iteration", "trials", "converged", "calm", "fresh", "tray_on"):
            setattr(worlds, name, wp.zeros(count, dtype=int, device=device))
        for name in (
            "alpha",
            "slope",
            "longest",
            "dt",
            "time",
            "keep",
            "moved",
            "margin",
            "speed",
            "tray",
            "tray_load",
            "idle",
        ):
            setattr(worlds, name, wp.zeros(count, dtype=float, device=device))
        return worlds

    def _allocate_system(self, mesh: Mesh | None) -> System:
        system = System()
        unknowns = 6 * self.bodies
        width = 0
        if mesh is not None:
            width = 3 * int((mesh.cells.max(axis=1) - mesh.cells.min(axis=1)).max()) + 3
        system.nodes = self.nodes
        system.band = _padded(width + PADDING)
        system.row = system.band + _padded(1 + unknowns) + VECTOR
        shape = (self.count, max(3 * self.nodes * system.row, 1))
        system.bordered = wp.zeros(shape, dtype=float, device=self.device)
        edge = max(unknowns, 6)
        system.corner = wp.zeros((self.count, edge, edge), dtype=float, device=self.device)
        system.corner_load = wp.zeros((self.count, edge), dtype=float, device=self.device)
        system.schur = wp.zeros((self.count, edge * (edge + 2 * VECTOR)), dtype=float, device=self.device)
        return system

    def _record(self, laws: Laws) -> list[Any]:
        """Record one tick: end steps, evaluate forces, judge, find new directions, move to trial points."""
        plate, solid, rigid, worlds, system = self.plate, self.solid, self.rigid, self.worlds, self.system
        nodes, bodies = self.nodes, self.bodies
        cells, patches = self._cells, self._patches
        tick = (
            (memory.find_near_soft, cells, (plate, solid, rigid, worlds)),
            (memory.find_near_rigid, patches, (plate, rigid, worlds)),
            (memory.remember_soft, cells, (laws, plate, solid, rigid, worlds)),
            (memory.remember_rigid, patches, (laws, plate, rigid, worlds)),
            (stepping.next_step, None, (laws, worlds)),
            (stepping.begin_nodes, nodes, (laws, solid, worlds)),
            (stepping.begin_bodies, bodies, (laws, rigid, worlds)),
            (elements.add_elastic_forces, cells, (solid, worlds)),
            (contact.touch_soft, cells, (laws, plate, solid, rigid, worlds, system, False)),
            (contact.touch_rigid, patches, (laws, plate, rigid, worlds, system, False)),
            (stepping.judge, None, (laws, rigid, worlds)),
            (stepping.accept_nodes, nodes, (worlds,)),
            (stepping.accept_bodies, bodies, (worlds,)),
            (stepping.begin_system, nodes, (solid, worlds, system)),
            (stepping.begin_corner, bodies, (rigid, worlds, system)),
            (elements.add_elastic_tangent, cells, (solid, worlds, system)),
            (contact.touch_soft, cells, (laws, plate, solid, rigid, worlds, system, True)),
            (contact.touch_rigid, patches, (laws, plate, rigid, worlds, system, True)),
            (solve_newton, None, (rigid, worlds, system)),
            (stepping.aim, None, (rigid, worlds)),
            (stepping.try_nodes, nodes, (worlds,)),
            (stepping.try_bodies, bodies, (worlds,)),
        )
        return [
            wp.launch(
                kernel,
                dim=self.count if size is None else (self.count, size),
                inputs=list(inputs),
                device=self.device,
                record_cmd=True,
            )
            for kernel, size, inputs in tick
            if size is None or size > 0
        ]


def _padded(entries: int) -> int:
    return -(-entries // VECTOR) * VECTOR
