"""Small scenes and simulations for the simulator's tests."""

from collections.abc import Callable

import numpy as np
import pytest

from common.domain.bodies import Bodies, Box, Material, Plate
from common.domain.grid import Grid
from common.domain.scene import Item, State
from common.tasks.plating import dinner_plate, render_scene
from services.simulator.bodies import box_body
from services.simulator.settings import Settings
from services.simulator.simulation import Simulation

FRY = Material(550.0, 1e6, 0.3)
GRID = Grid(64, 64, 0.003)


@pytest.fixture
def slab() -> Callable[..., Item]:
    """Return what makes a rectangular item of ``columns`` x ``rows`` cells."""

    def make(
        columns: int = 30, rows: int = 20, *, thickness: float = 0.02, youngs_modulus: float = 5e4, grid: Grid = GRID
    ) -> Item:
        heights = np.zeros(grid.shape, dtype=np.float32)
        top, left = (grid.rows - rows) // 2, (grid.columns - columns) // 2
        heights[top : top + rows, left : left + columns] = thickness
        material = np.array([1050.0, youngs_modulus, 0.3])[:, None, None]
        return Item(heights, (material * (heights > 0)).astype(np.float32))

    return make


@pytest.fixture
def fry() -> Callable[..., Box]:
    """Return what makes a box of 6 x 1 x 1 cm, turned about z, then about its own long axis."""

    def make(
        x: float, y: float, z: float, yaw: float = 0.0, size: tuple[float, float, float] = (0.06, 0.01, 0.01)
    ) -> Box:
        orientation = np.array([0.0, 0.0, np.sin(yaw / 2), np.cos(yaw / 2)])
        return Box(np.array(size), np.array([x, y, z]), orientation, FRY)

    return make


@pytest.fixture
def state_of() -> Callable[..., State]:
    """Return what puts an item beside a plate with boxes that are at rest."""

    def make(item: Item, boxes: tuple[Box, ...] = (), grid: Grid = GRID) -> State:
        return State(render_scene(grid, Bodies(dinner_plate(), boxes)), item)

    return make


@pytest.fixture
def ground() -> Plate:
    """Return a flat plate."""
    return Plate(np.array([0.0, 1.0]), np.zeros(2))


@pytest.fixture
def box_world(ground: Plate) -> Callable[..., Simulation]:
    """Return what makes one world of boxes on flat ground, gravity tilted about y by ``slope`` [rad]."""

    def make(
        boxes: list[Box], *, slope: float = 0.0, undamped: bool = False, settings: Settings | None = None
    ) -> Simulation:
        simulation = Simulation(
            plate=ground,
            mesh=None,
            samples=None,
            bodies=[box_body(box, settings or Settings()) for box in boxes],
            settings=settings or Settings(),
            gravity=(9.81 * np.sin(slope), 0.0, -9.81 * np.cos(slope)),
            undamped=undamped,
        )
        simulation.place(
            np.zeros((1, 0, 3)),
            np.array([[box.position for box in boxes]]),
            np.array([[box.orientation for box in boxes]]),
        )
        return simulation

    return make
