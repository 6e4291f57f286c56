from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray
from soft_scenes import DENSITY, GRAVITY, Alone, alone, bar

from services.simulator.settings import LEVELS, Settings


def mean_over(world: Alone, face: NDArray[np.bool_], values: NDArray[np.float64]) -> float:
    """Return the mean of a bilinear field over a face of equal cells: a node counts as often as cells meet there."""
    meeting = np.bincount(world.mesh.cells.ravel(), minlength=len(face))
    return float(np.average(values[face], weights=meeting[face]))


@pytest.mark.parametrize("poisson_ratio", [0.2, 0.3, 0.45])
@pytest.mark.parametrize("youngs_modulus", [2e4, 1e5])
def test_a_block_on_a_frictionless_floor_widens_by_poisson_s_ratio_times_its_mean_stress(
    poisson_ratio: float, youngs_modulus: float
) -> None:
    """By Betti's theorem the mean over each side is exact, however the floor's pressure is spread."""
    edges = 0.06, 0.04, 0.02
    block = bar(*edges, youngs_modulus=youngs_modulus, poisson_ratio=poisson_ratio)
    world = alone(block, settings=replace(Settings(), friction=0.0))
    outcome = world.simulation.run()
    shift = world.shift(outcome)
    expected = poisson_ratio * DENSITY * GRAVITY * edges[2] / 2 / youngs_modulus
    assert outcome.settled[0]
    for axis in (0, 1):
        high, low = (mean_over(world, world.end(axis, side), shift[:, axis]) for side in (1, -1))
        assert (high - low) / edges[axis] == pytest.approx(expected, rel=0.003)


@pytest.mark.parametrize("level", ["default", "fine"])
def test_two_blocks_of_different_materials_are_each_compressed_by_their_own_modulus(level: str) -> None:
    both = bar(0.12, 0.04, 0.02, youngs_modulus=lambda x, y: np.where(x < 0, 1e4, 5e4))
    gap = np.abs(np.linspace(-1, 1, both.heights.shape[1])) < 0.16
    heights, materials = np.where(gap, 0, both.heights), np.where(gap, 0, both.materials)
    world = alone(replace(both, heights=heights, materials=materials), settings=LEVELS[level])
    outcome = world.simulation.run()
    drop = world.shift(outcome)[:, 2]
    assert outcome.settled[0]
    for side, youngs_modulus in ((-1, 1e4), (1, 5e4)):
        own = np.sign(world.start[:, 0]) == side
        top, bottom = (mean_over(world, own & world.end(2, end), drop) for end in (1, -1))
        assert bottom - top == pytest.approx(DENSITY * GRAVITY * 0.02**2 / 2 / youngs_modulus, rel=0.003)
