"""Soft items without fries, for comparisons with theory and with other programs."""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from common.domain.bodies import Plate
from common.domain.grid import Grid
from common.domain.scene import Item
from services.simulator.mesh import Mesh, build_mesh
from services.simulator.outline import outline_of
from services.simulator.samples import Samples, item_samples
from services.simulator.settings import Settings
from services.simulator.simulation import Outcome, Simulation

DENSITY, GRAVITY = 1050.0, 9.81
GRID = Grid(64, 64, 0.0025)
FLOOR = Plate(np.array([0.0, 1.0]), np.zeros(2))
ABYSS = Plate(np.array([0.0, 1.0]), np.full(2, -0.5))

Field = Callable[[NDArray[np.float64], NDArray[np.float64]], NDArray[np.float64]]


def bar(
    length: float, width: float, thickness: float, *, youngs_modulus: float | Field, poisson_ratio: float = 0.0
) -> Item:
    """Return a bar along x, its edges [m] even multiples of the grid's cell; Young's modulus [Pa] may be of x, y."""
    x, y = np.meshgrid(GRID.x, GRID.y)
    heights = np.where((np.abs(x) < length / 2) & (np.abs(y) < width / 2), thickness, 0.0)
    modulus = youngs_modulus(x, y) if callable(youngs_modulus) else np.full(GRID.shape, youngs_modulus)
    materials = np.stack([np.full(GRID.shape, DENSITY), modulus, np.full(GRID.shape, poisson_ratio)]) * (heights > 0)
    return Item(heights.astype(np.float32), materials.astype(np.float32))


@dataclass(frozen=True)
class Alone:
    """A soft item alone on a plate, placed and ready to run.

    Attributes:
        mesh: Its mesh, in the item's own frame.
        samples: Its contact samples, likewise.
        start: Where the nodes start ``(N, 3)`` [m].
        simulation: The world.
    """

    mesh: Mesh
    samples: Samples
    start: NDArray[np.float64]
    simulation: Simulation

    def end(self, axis: int, side: int) -> NDArray[np.bool_]:
        """Return which nodes are on the face at the low (-1) or high (1) end of an axis of the item ``(N,)``."""
        place = side * self.mesh.positions[:, axis]
        return place > place.max() - 1e-9

    def shift(self, outcome: Outcome) -> NDArray[np.float64]:
        """Return how far each node has moved ``(N, 3)`` [m]."""
        return outcome.nodes[0] - self.start

    def points(self, outcome: Outcome, own: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return where points of the item's frame ``(P, 3)`` [m] have come to ``(P, 3)`` [m]."""
        cells, weights = self.mesh.embed(own)
        return (weights[:, :, None] * outcome.nodes[0][self.mesh.cells[cells]]).sum(axis=1)


def alone(
    item: Item,
    *,
    settings: Settings,
    plate: Plate = FLOOR,
    x: float = 0.0,
    slope: float = 0.0,
    clamped: bool = False,
    undamped: bool = False,
) -> Alone:
    """Place an item at ``x`` [m] on a plate, gravity tilted towards x by ``slope`` [rad]; clamp its low end in x."""
    outline = outline_of(item, GRID)
    mesh = build_mesh(outline, settings)
    samples = item_samples(outline, mesh, settings)
    simulation = Simulation(
        plate=plate,
        mesh=mesh,
        samples=samples,
        bodies=[],
        settings=settings,
        gravity=(GRAVITY * np.sin(slope), 0.0, -GRAVITY * np.cos(slope)),
        pinned=mesh.positions[:, 0] < mesh.positions[:, 0].min() + 1e-9 if clamped else None,
        undamped=undamped,
    )
    start = mesh.positions + np.array([x, 0.0, 0.0])
    simulation.place(start[None], np.zeros((1, 0, 3)), np.zeros((1, 0, 4)))
    return Alone(mesh, samples, start, simulation)
