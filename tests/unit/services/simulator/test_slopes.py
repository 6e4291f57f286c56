from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
from soft_scenes import GRAVITY, alone, bar

from common.domain.bodies import Box
from services.simulator.settings import Settings
from services.simulator.simulation import Simulation

STEP, TIME = 0.005, 0.3
PATH = replace(
    Settings(),
    first_step=STEP,
    longest_step=STEP,
    shortest_step=STEP,
    iterations=20,
    tolerance=1e-8,
    relative_tolerance=1e-4,
    longest_time=TIME,
)
"""Settings under which the path is to be trusted, not only its end."""

SLOPES = [np.radians(degrees) for degrees in (1.0, 5.0)]


def way(slope: float, time: float) -> float:
    """Return how far a body slides from rest in ``time`` [m], by implicit Euler: g (sin - mu cos) t (t + dt) / 2."""
    return GRAVITY * (np.sin(slope) - PATH.friction * np.cos(slope)) * time * (time + STEP) / 2


@pytest.mark.parametrize("yaw", [0.0, np.pi / 4, np.pi / 2], ids=["along", "askew", "across"])
@pytest.mark.parametrize("beyond", SLOPES)
def test_a_box_slides_down_a_slope_as_fast_as_it_should(
    fry: Callable[..., Box], box_world: Callable[..., Simulation], yaw: float, beyond: float
) -> None:
    slope = float(np.arctan(PATH.friction)) + beyond
    outcome = box_world([fry(0, 0, 0.005, yaw)], slope=slope, undamped=True, settings=PATH).run()
    x, y, _ = outcome.positions[0, 0]
    assert x == pytest.approx(way(slope, float(outcome.time[0])), rel=0.01)
    assert abs(y) < 1e-5


@pytest.mark.parametrize("beyond", SLOPES)
def test_a_soft_item_slides_down_a_slope_as_fast_as_it_should(beyond: float) -> None:
    slope = float(np.arctan(PATH.friction)) + beyond
    item = bar(0.08, 0.06, 0.01, youngs_modulus=3e5, poisson_ratio=0.3)
    world = alone(item, settings=PATH, slope=slope, undamped=True)
    outcome = world.simulation.run()
    assert world.shift(outcome)[:, 0].mean() == pytest.approx(way(slope, float(outcome.time[0])), rel=0.01)
