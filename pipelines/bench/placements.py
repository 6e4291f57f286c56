"""Place items of the sampler's scenes and measure each placement: time, rest, penetration, resolution, sensitivity."""

import time
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from common.domain.grid import Grid
from common.domain.scene import State
from common.tasks.plating_sampler import sample_action, sample_state
from services.simulator.model import SimulatorModel
from services.simulator.settings import LEVELS
from services.simulator.settle import settle_boxes

UNMOVED = 1e-3
"""Nothing rolls where no fry moves by more than this [m]."""

SHIFTS = {"10um": 1e-5, "100um": 1e-4, "1mm": 1e-3}
"""How far the action is moved along x to see how much the outcome depends on it [m]."""


@dataclass(frozen=True)
class Settle:
    """One placement that was compared with another.

    Attributes:
        wall_s: Wall time from the action to the heightmap [s].
        cpu_s: Processor time of the same [s].
        settled: Whether it came to rest.
        moved: Largest displacement of a fry [m].
        rms: Difference of the heightmap to the one that it is compared with, RMS over the grid [m].
    """

    wall_s: float
    cpu_s: float
    settled: bool
    moved: float
    rms: float


@dataclass(frozen=True)
class PlacementRecord:
    """One scene, one action, one placement, and what it was compared with.

    Attributes:
        index: Number of the scene; with the seed it draws the scene again.
        rigid: Whether the item is one rigid body.
        youngs_modulus: The item's largest one [Pa].
        level: The level measured.
        prepare_s: Wall time of meshing and uploading the state [s].
        wall_s: Wall time from the action to the heightmap [s].
        cpu_s: Processor time of the same [s].
        settled: Whether it came to rest.
        creep: Largest speed in 0.2 s of undamped dynamics from there [m/s].
        depth: Deepest penetration [m].
        moved: Largest displacement of a fry [m].
        levels: The same action at every level, compared with ``fine``; empty where nothing was compared.
        shifts: The action moved by `SHIFTS`, compared with the unmoved one.
    """

    index: int
    rigid: bool
    youngs_modulus: float
    level: str
    prepare_s: float
    wall_s: float
    cpu_s: float
    settled: bool
    creep: float
    depth: float
    moved: float
    levels: dict[str, Settle] = field(default_factory=dict)
    shifts: dict[str, Settle] = field(default_factory=dict)

    @property
    def calm(self) -> bool:
        """Whether no fry moved by more than `UNMOVED`, at any level it was run at but ``coarse``."""
        return max(self.moved, *(run.moved for name, run in self.levels.items() if name != "coarse"), 0) <= UNMOVED


def draw_scene(seed: int, index: int) -> tuple[State, NDArray[np.float64], np.random.Generator]:
    """Return the state and the action ``(2,)`` [m] of one scene, and the generator for more actions."""
    rng = np.random.default_rng([seed, index])
    state = sample_state(rng, Grid(), settle=settle_boxes)
    return state, sample_action(rng, state), rng


def measure_placement(
    state: State,
    action: NDArray[np.float64],
    *,
    index: int,
    level: str,
    device: str,
    compare: bool,
    compare_calm: bool = False,
) -> PlacementRecord:
    """Place one item and measure everything about it.

    Args:
        state: Scene and item.
        action: Where to place it ``(2,)`` [m].
        index: Number of the scene.
        level: The level to measure.
        device: Warp's name of the device.
        compare: Also run the other levels and the moved actions.
        compare_calm: Do so if no fry moved.
    """
    from services.simulator.penetration import deepest_penetration

    model = SimulatorModel.at_level(level, device=device)
    started = time.perf_counter()
    placement = model.placement(state)
    prepare_s = time.perf_counter() - started
    run = _Timed(model, state, action)
    depth = deepest_penetration(placement, run.placed.outcome)
    creep = float(placement.simulation.verify_rest()[0])
    levels: dict[str, Settle] = {}
    shifts: dict[str, Settle] = {}
    if compare or (compare_calm and run.moved <= UNMOVED):
        runs = {level: run} | {
            other: _Timed(SimulatorModel.at_level(other, device=device), state, action)
            for other in LEVELS
            if other != level
        }
        levels = {name: runs[name].compared_with(runs["fine"]) for name in LEVELS}
        shifts = {
            name: _Timed(model, state, action + np.array([distance, 0.0])).compared_with(run)
            for name, distance in SHIFTS.items()
        }
    return PlacementRecord(
        index=index,
        rigid=state.item.is_rigid,
        youngs_modulus=float(state.item.materials[1].max()),
        level=level,
        prepare_s=prepare_s,
        wall_s=run.wall_s,
        cpu_s=run.cpu_s,
        settled=run.settled,
        creep=creep,
        depth=depth,
        moved=run.moved,
        levels=levels,
        shifts=shifts,
    )


def batch_time(states: list[tuple[State, NDArray[np.float64]]], *, level: str, device: str) -> tuple[float, float]:
    """Return wall and processor time of batches of actions, each of a new state: meshing counts [s]."""
    model = SimulatorModel.at_level(level, device=device)
    wall, cpu = time.perf_counter(), time.process_time()
    for state, actions in states:
        model.predict(state, actions)
    return time.perf_counter() - wall, time.process_time() - cpu


class _Timed:
    """One timed run of a prepared placement."""

    def __init__(self, model: SimulatorModel, state: State, action: NDArray[np.float64]) -> None:
        placement = model.placement(state)
        wall, cpu = time.perf_counter(), time.process_time()
        self.placed = placement.run(action[None])
        self.wall_s = time.perf_counter() - wall
        self.cpu_s = time.process_time() - cpu
        self.settled = bool(self.placed.settled[0])
        first = int(placement.item is not None)
        boxes = np.array([box.position for box in placement.boxes]).reshape(-1, 3)
        shifts = np.linalg.norm(self.placed.outcome.positions[0, first:] - boxes, axis=1)
        self.moved = float(shifts.max(initial=0))

    def compared_with(self, other: "_Timed") -> Settle:
        difference = self.placed.heights[0].astype(np.float64) - other.placed.heights[0]
        rms = float(np.sqrt(np.mean(difference**2)))
        return Settle(self.wall_s, self.cpu_s, self.settled, self.moved, rms)
