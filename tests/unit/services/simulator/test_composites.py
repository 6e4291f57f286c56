import numpy as np
import pytest
from soft_scenes import ABYSS, DENSITY, GRAVITY, Field, alone, bar

from services.simulator.settings import LEVELS, Settings
from tests.references.elastica import hanging_tip

LENGTH, WIDTH, THICKNESS = 0.12, 0.03, 0.01
WEIGHT = 12 * DENSITY * GRAVITY * LENGTH**3 / THICKNESS**2
"""Load of the elastica times Young's modulus [Pa]."""


def depth_of_tip(level: str, youngs_modulus: Field) -> float:
    """Return how far a clamped beam's free end comes down, in lengths of the beam."""
    beam = bar(LENGTH, WIDTH, THICKNESS, youngs_modulus=youngs_modulus)
    world = alone(beam, settings=LEVELS[level], plate=ABYSS, clamped=True)
    outcome = world.simulation.run()
    assert outcome.settled[0]
    return float(-world.shift(outcome)[world.end(0, 1), 2].mean()) / LENGTH


@pytest.mark.parametrize("level", ["default", "fine"])
@pytest.mark.parametrize(("flesh", "bone"), [(1e5, 2e6), (2e4, 4e6)])
def test_a_bone_along_a_beam_carries_it_with_its_share_of_the_stiffness(level: str, flesh: float, bone: float) -> None:
    """The bone is a third of a cell wide: a cell's modulus is the mean over it, as for springs side by side."""
    tip = depth_of_tip(level, lambda x, y: np.where(np.abs(y) < WIDTH / 6, bone, flesh))
    assert tip == pytest.approx(hanging_tip(3 * WEIGHT / (2 * flesh + bone))[1], rel=0.02)
    assert tip < hanging_tip(WEIGHT / flesh)[1] / 2


@pytest.mark.parametrize("level", ["default", "fine"])
@pytest.mark.parametrize(("inner", "outer"), [(5e5, 5e6), (2e6, 2e5), (1e6, 1e8)])
def test_a_beam_of_two_halves_bends_where_it_is_soft(level: str, inner: float, outer: float) -> None:
    tip = depth_of_tip(level, lambda x, y: np.where(x < 0, inner, outer))
    stiffest = Settings().stiffest
    expected = hanging_tip(WEIGHT / inner, outer_load=WEIGHT / min(outer, stiffest))[1]
    assert tip == pytest.approx(expected, rel=0.02)
