import json
from pathlib import Path

import numpy as np
import pytest
from soft_scenes import ABYSS, DENSITY, GRAVITY, alone, bar

from services.simulator.settings import LEVELS
from tests.references.elastica import hanging_tip

LENGTH, WIDTH, THICKNESS = 0.14, 0.02, 0.01
CLAMPED = json.loads((Path(__file__).parents[3] / "references" / "bars.json").read_text())["clamped"]


def hang(level: str, youngs_modulus: float, poisson_ratio: float) -> np.ndarray:
    beam = bar(LENGTH, WIDTH, THICKNESS, youngs_modulus=youngs_modulus, poisson_ratio=poisson_ratio)
    world = alone(beam, settings=LEVELS[level], plate=ABYSS, clamped=True)
    outcome = world.simulation.run()
    assert outcome.settled[0]
    return world.shift(outcome)[world.end(0, 1)].mean(axis=0)


@pytest.mark.parametrize("level", ["default", "fine"])
@pytest.mark.parametrize("load", [2.0, 6.0])
def test_a_beam_hangs_as_deep_as_the_elastica(level: str, load: float) -> None:
    """The tip comes down by 0.24 and 0.55 of the length; without a Poisson effect, which the theory does not have."""
    youngs_modulus = 12 * DENSITY * GRAVITY * LENGTH**3 / (load * THICKNESS**2)
    along, below = hanging_tip(load)
    tip = hang(level, youngs_modulus, 0.0) / LENGTH
    assert -tip[2] == pytest.approx(below, rel=0.01)
    assert -tip[0] == pytest.approx(1 - along, rel=0.01)


@pytest.mark.parametrize(("level", "errors"), [("default", (0.02, 0.04)), ("fine", (0.01, 0.015))])
@pytest.mark.parametrize("case", [0, 1])
def test_a_hanging_beam_with_a_poisson_effect_agrees_with_calculix(
    level: str, errors: tuple[float, float], case: int
) -> None:
    reference = CLAMPED[case]
    tip = hang(level, reference["bar"]["youngs_modulus"], reference["bar"]["poisson_ratio"])
    assert tip[2] == pytest.approx(reference["tip_m"][1], rel=errors[case])


def test_the_two_references_agree_but_for_the_clamp_s_hold_on_the_poisson_effect() -> None:
    for reference in CLAMPED:
        load = 12 * DENSITY * GRAVITY * LENGTH**3 / (reference["bar"]["youngs_modulus"] * THICKNESS**2)
        assert -reference["tip_m"][1] / LENGTH == pytest.approx(hanging_tip(load)[1], rel=0.02)
