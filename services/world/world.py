"""The world's stand-in: tables with a plate, fries and a steak, a robot that places it, a depth camera that looks.

There is no robot here. This is a simulation that differs from `services.simulator` in what the real world would differ
in, and nothing but this module reads its parameters: a finer mesh, other friction and damping, other fries, another
plate, six uneven steaks, a hand that misses a little, and a camera with faults.
"""

from dataclasses import replace
from functools import lru_cache, partial

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import map_coordinates

from common.domain.bodies import Material, Plate
from common.domain.errors import ModelError, RequestError
from common.domain.grid import Grid
from common.domain.scene import State
from common.domain.world import Sight, World
from common.tasks.plating import dinner_plate
from common.tasks.plating_sampler import LAYOUTS, MORE_LAYOUTS, Fries, sample_scene
from services.simulator.model import SimulatorModel
from services.simulator.settings import LEVELS
from services.simulator.settle import settle_boxes
from services.world.optics import UNIT, Optics
from services.world.steaks import STEAKS, Steak, draw_steak

GRID = Grid(192, 192, 0.0015)
PHYSICS = replace(LEVELS["fine"], friction=0.36, keep_fast=0.93, tray_speed=0.09)
FRIES = Fries(length=(0.042, 0.082), section=(0.0080, 0.0125), density=(430, 680))
OPTICS = Optics()
HAND = (0.0007, -0.0005)
"""Where the hand puts things, from where it was told to [m]."""
TREMBLE = 3e-4
"""Standard deviation of what varies in that [m]."""
STIFFNESS_ERROR = 0.15
"""Standard deviation of the logarithm of the Young's modulus that the robot is told of, about the true one [-]."""
FIRST_DRAWS, BEFORE, ITEM, PLATE, AFTER = range(5)


class StandIn(World):
    """Tables by number; the same number and action always look the same."""

    version = "1"

    def __init__(self) -> None:
        self._simulator = SimulatorModel(settings=PHYSICS, name="world")
        self._table = lru_cache(maxsize=4)(_lay)

    def warm(self) -> None:
        """Compile the kernels."""
        self._simulator.warm()

    def look(self, table: int) -> Sight:
        """Return what the robot sees of a table.

        Raises:
            ModelError: No fries came to rest on it.
        """
        steak, state = self._table(table)
        item, rng = state.item, np.random.default_rng([table, FIRST_DRAWS, 1])
        alone = state.scene.bodies
        assert alone is not None
        assert alone.plate is not None
        bare = alone.plate.heightmap(GRID)
        softness = float(np.exp(rng.normal(0, STIFFNESS_ERROR)))
        return Sight(
            before=_look(state.scene.heights, [table, BEFORE]),
            item=_look(bare + item.heights, [table, ITEM]),
            plate=_look(bare, [table, PLATE]),
            camera=OPTICS.calibrated,
            item_material=Material(1050.0, steak.material.youngs_modulus * softness, 0.3 if steak.is_rigid else 0.4),
            scene_material=Material(550.0, 1e6, 0.3),
            name=steak.name,
        )

    def execute(self, table: int, action: tuple[float, float]) -> NDArray[np.float32]:
        """Place the steak and return the depth image of what came to rest ``(h, w)`` [m].

        Raises:
            RequestError: The action is off the plate.
            ModelError: It did not come to rest.
        """
        if not np.isfinite(action).all() or np.abs(action).max() > 0.1:
            raise RequestError(f"action: expected one within 0.1 m of the plate's centre, got {action}")
        _, state = self._table(table)
        key = [table, AFTER, *(round(1e7 * value) + 10**7 for value in action)]
        missed = np.array(HAND) + np.random.default_rng(key).normal(0, TREMBLE, 2)
        placed = self._simulator.predict(state, (np.array(action) + missed)[None])
        if placed.warnings[0]:
            raise ModelError(f"table {table}: expected the steak to come to rest, got {placed.warnings[0]}")
        return _look(placed.heights[0], key)


def _lay(table: int) -> tuple[Steak, State]:
    """Draw a table."""
    if table < 0:
        raise RequestError(f"table: expected a number of 0 or more, got {table}")
    rng = np.random.default_rng([table, FIRST_DRAWS])
    steak = STEAKS[table % len(STEAKS)]
    layout = str(rng.choice([*LAYOUTS, *MORE_LAYOUTS]))
    settle = partial(settle_boxes, settings=replace(LEVELS["default"], friction=PHYSICS.friction))
    scene = sample_scene(rng, GRID, settle=settle, layout=layout, plate=_plate(), fries=FRIES)
    return steak, State(scene, draw_steak(steak, GRID, yaw=float(rng.uniform(0, 2 * np.pi))))


def _plate() -> Plate:
    """Return the world's plate: its rim is 6% higher than the dinner plate's."""
    known = dinner_plate()
    return Plate(known.radii, np.where(known.heights > 0, 1.06 * known.heights, known.heights))


def _look(heights: NDArray[np.floating], key: list[int]) -> NDArray[np.float32]:
    """Return the depth image of heights on `GRID` [m]; beyond it they go on as at its border."""

    def surface(x: NDArray[np.float64], y: NDArray[np.float64]) -> NDArray[np.float64]:
        rows, columns = y / GRID.cell + (GRID.rows - 1) / 2, x / GRID.cell + (GRID.columns - 1) / 2
        return map_coordinates(heights, [rows, columns], order=1, mode="nearest")

    return (OPTICS.see(surface, np.random.default_rng(key)) * UNIT).astype(np.float32)
