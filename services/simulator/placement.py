"""One state, ready to be simulated: its bodies at rest, its item meshed, its arrays on the device."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from common.domain.bodies import ROUNDING, Bodies, Box
from common.domain.errors import ModelError, RequestError
from common.domain.scene import State
from services.simulator.bodies import Body, box_body, item_body
from services.simulator.canvas import Canvas, Drawing
from services.simulator.mesh import build_mesh
from services.simulator.outline import outline_of
from services.simulator.samples import item_samples
from services.simulator.settings import Settings
from services.simulator.simulation import Outcome, Simulation

UNCHANGED = 1e-4
"""Where plate and boxes change by less than this, the state's own height is kept beside the item [m]."""

MOST_BOXES = 30
"""Boxes that fit in the bit sets of the contact search."""


@dataclass(frozen=True)
class Placed:
    """What a batch of placements led to.

    Attributes:
        heights: ``(B, H, W)`` [m].
        settled: Whether everything came to rest ``(B,)``.
        speed: Largest speed at the end ``(B,)`` [m/s].
        time: Simulated time ``(B,)`` [s].
        covered: Share of each cell in which the item is the topmost thing ``(B, H, W)`` [-].
        pixels: Where the middle of the top of each of the item's pixels is ``(B, P, 3)`` [m].
        outcome: Where nodes and bodies are.
    """

    heights: NDArray[np.float32]
    settled: NDArray[np.bool_]
    speed: NDArray[np.float32]
    time: NDArray[np.float32]
    covered: NDArray[np.float32]
    pixels: NDArray[np.float32]
    outcome: Outcome


class Placement:
    """All worlds of one state: `run` places its item at several actions at once.

    Args:
        state: What is placed where.
        bodies: The state's plate and boxes, at rest.
        settings: Resolution and laws.
        worlds: Actions that one run takes.
        device: Warp's name of the device.
    """

    def __init__(self, state: State, bodies: Bodies, *, settings: Settings, worlds: int, device: str) -> None:
        if bodies.plate is None:
            raise ModelError("expected bodies with a plate, got none")
        if len(bodies.boxes) > MOST_BOXES:
            raise RequestError(f"expected at most {MOST_BOXES} boxes, got {len(bodies.boxes)}")
        self.plate = bodies.plate
        self.boxes = bodies.boxes
        self.settings = settings
        self.state = state
        self.count = worlds
        _check_boxes(bodies.boxes)
        self.outline = outline_of(state.item, state.grid)
        length, plate_radius = float(np.ptp(self.outline.centres, axis=0).max()), float(self.plate.radii[-1])
        if length > 2 * plate_radius:
            raise RequestError(
                f"expected an item smaller than the plate of {2 * plate_radius:g} m, got one of {length:g} m"
            )
        self.mesh = build_mesh(self.outline, settings)
        box_bodies = [box_body(box, settings) for box in self.boxes]
        self.item: Body | None = item_body(self.outline, self.mesh, settings) if state.item.is_rigid else None
        self.simulation = Simulation(
            plate=self.plate,
            mesh=None if self.item else self.mesh,
            samples=None if self.item else item_samples(self.outline, self.mesh, settings),
            bodies=[self.item, *box_bodies] if self.item else box_bodies,
            rigid_item=self.item is not None,
            worlds=worlds,
            settings=settings,
            device=device,
        )
        self._box_points = [
            box.position + body.samples.points @ box.rotation.T
            for box, body in zip(self.boxes, box_bodies, strict=True)
        ]
        self._canvas = Canvas(self.simulation, self.outline, self.mesh, self.item, state.grid, self.plate)
        self._before = self._canvas.draw_scene(self._poses(np.zeros((worlds, 3)), np.zeros(worlds)))[0]

    def run(self, actions: NDArray[np.float64], *, check: Callable[[], None] | None = None) -> Placed:
        """Place the item at up to ``worlds`` actions: its centre (x, y) [m] and, in a third column, its yaw [rad].

        Raises:
            RequestError: An action puts the item's centre off the grid.
        """
        half_x, half_y = self.state.grid.half_extent
        if (np.abs(actions[:, :2]) > (half_x, half_y)).any():
            raise RequestError(
                f"expected actions on the grid of {half_x:g} x {half_y:g} m about its centre, got {actions}"
            )
        filled = actions[np.minimum(np.arange(self.count), len(actions) - 1)]
        yaws = filled[:, 2] if filled.shape[1] == 3 else np.zeros(self.count)
        turns = np.stack([_turn(yaw) for yaw in yaws])
        heights = [self.start_height(*placed) for placed in zip(filled[:, :2], turns, strict=True)]
        shifts = np.column_stack([filled[:, :2], heights])
        nodes = np.zeros((self.count, 0, 3))
        if self.item is None:
            nodes = self.mesh.positions @ turns.transpose(0, 2, 1) + shifts[:, None, :]
        self.simulation.place(
            nodes,
            *self._poses(shifts, yaws),
            tray=shifts[:, 2],
            item_velocity=-self.settings.tray_speed,
        )
        outcome = self.simulation.run(check=check)
        seen, count = self._canvas.draw(), len(actions)
        return Placed(
            heights=self._with_unexplained(seen)[:count],
            settled=outcome.settled[:count],
            speed=outcome.speed[:count],
            time=outcome.time[:count],
            covered=1 - seen.uncovered[:count],
            pixels=seen.pixels[:count],
            outcome=outcome,
        )

    def heights_now(self) -> NDArray[np.float32]:
        """Return the heightmaps of all worlds as they are now, also while `run` calls ``check`` ``(W, H, W)`` [m]."""
        return self._with_unexplained(self._canvas.draw())

    def _with_unexplained(self, seen: Drawing) -> NDArray[np.float32]:
        """Return heights to which what neither plate nor boxes account for is added where nothing moved."""
        unmoved = np.abs(seen.without_item - self._before) < UNCHANGED
        unexplained = self.state.scene.heights - self._before
        heights = np.where(unmoved, seen.heights + seen.uncovered * unexplained, seen.heights)
        return np.where(unmoved & (seen.uncovered == 1), self.state.scene.heights, heights).astype(np.float32)

    def start_height(self, action: NDArray[np.float64], turn: NDArray[np.float64] | None = None) -> float:
        """Return the height from which the tray lowers the item: just above the highest thing below it [m].

        Args:
            action: The item's centre ``(2,)`` [m].
            turn: Rotation matrix of the item ``(3, 3)``, None: as the state shows it.
        """
        plane = np.eye(2) if turn is None else turn[:2, :2]
        spread = self.outline.pixel / 2 * np.array([[-1, -1], [1, -1], [1, 1], [-1, 1]])
        corners = self.outline.centres[:, None, :] + spread
        radius = np.linalg.norm(corners @ plane.T + action, axis=2)
        highest = float(self.plate.height(radius).max())
        for points in self._box_points:
            around = (points[:, None, :2] - action) @ plane + np.concatenate([[[0.0, 0.0]], 2 * spread])
            below = self.outline.locate(around.reshape(-1, 2))[2].reshape(len(points), -1).any(axis=1)
            if below.any():
                highest = max(highest, float(points[below, 2].max()) + ROUNDING)
        return highest

    def _poses(
        self, shifts: NDArray[np.float64], yaws: NDArray[np.float64]
    ) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Return positions ``(W, M, 3)`` [m] and orientations ``(W, M, 4)`` of item, if rigid, and boxes."""
        positions = np.array([box.position for box in self.boxes]).reshape(-1, 3)
        orientations = np.array([box.orientation for box in self.boxes]).reshape(-1, 4)
        positions = np.repeat(positions[None], self.count, axis=0)
        orientations = np.repeat(orientations[None], self.count, axis=0)
        if self.item is not None:
            turns = np.stack([_turn(yaw) for yaw in yaws])
            own = (turns @ self.item.centre + shifts)[:, None, :]
            nothing = np.zeros(self.count)
            upright = np.column_stack([nothing, nothing, np.sin(yaws / 2), np.cos(yaws / 2)])[:, None, :]
            positions = np.concatenate([own, positions], axis=1)
            orientations = np.concatenate([upright, orientations], axis=1)
        return positions, orientations


def _turn(yaw: float) -> NDArray[np.float64]:
    """Return the rotation matrix of a turn about z ``(3, 3)``."""
    cos, sin = np.cos(yaw), np.sin(yaw)
    return np.array([[cos, -sin, 0.0], [sin, cos, 0.0], [0.0, 0.0, 1.0]])


def keep_apart(boxes: Sequence[Box]) -> tuple[Box, ...]:
    """Return boxes without those that overlap a larger one, as boxes found in a noisy heightmap may do."""
    kept: list[Box] = []
    for box in sorted(boxes, key=lambda one: -one.size.prod()):
        if not any(_overlap(box, other) for other in kept):
            kept.append(box)
    return tuple(box for box in boxes if any(box is one for one in kept))


def _check_boxes(boxes: tuple[Box, ...]) -> None:
    """Raise `RequestError` where boxes overlap: no contact force can repair that."""
    for index, box in enumerate(boxes):
        for number, other in enumerate(boxes[:index]):
            if _overlap(box, other):
                raise RequestError(f"expected boxes that do not overlap, got box {number} inside box {index}")


def _overlap(box: Box, other: Box) -> bool:
    """Return whether the axis of one of the boxes runs deep inside the other."""
    for one, two in ((box, other), (other, box)):
        axis = one.rotation[:, int(np.argmax(one.size))] * one.size.max() / 2
        line = one.position + np.linspace(-1, 1, 41)[:, None] * axis
        inside = np.abs((line - two.position) @ two.rotation) < two.size / 2 - ROUNDING
        if inside.all(axis=1).any():
            return True
    return False
