"""One scene for the simulator and its peers: a soft steak lowered on nine fries, the same nodes for all."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from common.domain.bodies import Bodies, Box, Material, Plate
from common.domain.grid import Grid
from common.domain.scene import Item, State
from common.tasks.plating import render_scene
from services.simulator.model import SimulatorModel
from services.simulator.settle import settle_boxes

STEAK = Material(density=1050.0, youngs_modulus=5e4, poisson_ratio=0.3)
STEAK_SIZE = (0.141, 0.090, 0.020)
FRY = Material(density=550.0, youngs_modulus=1e6, poisson_ratio=0.3)
FRY_SIZE = (0.06, 0.01, 0.01)
FRICTION = 0.5
START_SPEED = 0.12

FRIES = (
    (-0.045, 0.000, 0.0055, 1.57),
    (-0.025, 0.002, 0.0055, 1.62),
    (-0.005, -0.002, 0.0055, 1.52),
    (-0.030, -0.020, 0.0165, 0.05),
    (-0.030, 0.002, 0.0165, -0.05),
    (-0.030, 0.022, 0.0165, 0.10),
    (0.030, 0.030, 0.0055, 0.30),
    (0.045, -0.005, 0.0055, 1.20),
    (0.025, -0.035, 0.0055, -0.20),
)
"""Centre [m] and yaw [rad] of every fry before it settles: two layers under one half of the steak."""

FIVE_TETRAHEDRA = (
    ((0, 1, 3, 4), (1, 2, 3, 6), (1, 4, 5, 6), (3, 4, 6, 7), (1, 3, 4, 6)),
    ((0, 1, 2, 5), (0, 2, 3, 7), (0, 5, 7, 4), (2, 7, 5, 6), (0, 2, 7, 5)),
)
"""The two ways to cut a hexahedron that alternate, so that neighbours share their diagonals."""


@dataclass(frozen=True)
class PeerScene:
    """What every peer builds from.

    Attributes:
        state: Scene and item for the simulator; the plate is a plane, which every peer has.
        boxes: The fries at rest.
        nodes: The steak's nodes where it starts ``(I, J, L, 3)`` [m].
        tetrahedra: Five for every hexahedron of the simulator's mesh, positive volumes ``(E, 4)``.
    """

    state: State
    boxes: tuple[Box, ...]
    nodes: NDArray[np.float64]
    tetrahedra: NDArray[np.intp]

    @property
    def volume(self) -> float:
        """Volume of the steak [m3]."""
        return float(np.ptp(self.nodes.reshape(-1, 3), axis=0).prod())


def make_peer_scene() -> PeerScene:
    """Let the fries settle, mesh the steak and put it just above them."""
    grid, plane = Grid(), Plate(np.array([0.0, 1.0]), np.zeros(2))
    boxes = settle_boxes(plane, [_fry(*place) for place in FRIES])
    length, width, thickness = STEAK_SIZE
    covered = (np.abs(grid.x[None, :]) < length / 2) & (np.abs(grid.y[:, None]) < width / 2)
    material = np.array([STEAK.density, STEAK.youngs_modulus, STEAK.poisson_ratio])[:, None, None]
    item = Item((covered * thickness).astype(np.float32), (covered * material).astype(np.float32))
    state = State(render_scene(grid, Bodies(plane, boxes)), item)
    placement = SimulatorModel().placement(state)
    shape = (*placement.mesh.heights.shape, placement.mesh.layers + 1, 3)
    start = np.array([0.0, 0.0, placement.start_height(np.zeros(2))])
    nodes = placement.mesh.positions.reshape(shape)
    return PeerScene(state, boxes, nodes + start, cut_into_tetrahedra(nodes))


def cut_into_tetrahedra(nodes: NDArray[np.float64]) -> NDArray[np.intp]:
    """Return the nodes of five tetrahedra a cell of a lattice ``(I, J, L, 3)``, each of positive volume ``(E, 4)``."""
    numbers = np.arange(nodes[..., 0].size).reshape(nodes.shape[:3])
    parts = []
    for corner in np.ndindex(*(count - 1 for count in numbers.shape)):
        i, j, k = corner
        ring = [(i, j), (i + 1, j), (i + 1, j + 1), (i, j + 1)]
        eight = np.array([numbers[a, b, level] for level in (k, k + 1) for a, b in ring])
        parts.append(eight[np.array(FIVE_TETRAHEDRA[sum(corner) % 2])])
    tetrahedra = np.concatenate(parts)
    points = nodes.reshape(-1, 3)[tetrahedra]
    inverted = np.linalg.det(points[:, 1:] - points[:, :1]) < 0
    tetrahedra[inverted] = tetrahedra[inverted][:, [0, 2, 1, 3]]
    return tetrahedra


def _fry(x: float, y: float, z: float, yaw: float) -> Box:
    turn = np.array([0.0, 0.0, np.sin(yaw / 2), np.cos(yaw / 2)])
    return Box(np.array(FRY_SIZE), np.array([x, y, z]), turn, FRY)
