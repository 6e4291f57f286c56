import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray
from soft_scenes import Alone, alone, bar

from common.domain.bodies import Plate
from services.simulator.settings import LEVELS
from services.simulator.simulation import Outcome

REFERENCE = json.loads((Path(__file__).parents[3] / "references" / "bars.json").read_text())
ON_SUPPORTS, OVER_EDGE = REFERENCE["two_supports"], REFERENCE["over_an_edge"]
FAR = 0.5
"""Radius at which the plate's rings are straight enough to be supports: 0.1 mm over the bar's width [m]."""


def plate_of(*profiles: NDArray[np.float64]) -> Plate:
    """Return a plate whose rings around the radius `FAR` have these profiles, points x, z, with slopes between them."""
    down = np.array([0.02, -0.03])
    parts = [np.concatenate([part[:1] + down * [-1, 1], part, part[-1:] + down]) for part in profiles]
    radii, heights = np.concatenate(parts).T
    return Plate(np.append(0.0, FAR + radii), np.append(heights[0], heights))


def run(reference: dict[str, float], plate: Plate, *, level: str, x: float, clamped: bool) -> tuple[Alone, Outcome]:
    """Let a bar settle on a plate without friction, its middle ``x`` [m] from `FAR`."""
    names = "length", "width", "thickness"
    item = bar(
        *(reference[name] for name in names),
        youngs_modulus=reference["youngs_modulus"],
        poisson_ratio=reference["poisson_ratio"],
    )
    world = alone(item, settings=replace(LEVELS[level], friction=0.0), plate=plate, x=FAR + x, clamped=clamped)
    outcome = world.simulation.run()
    assert outcome.settled[0]
    return world, outcome


@pytest.mark.parametrize("level", ["default", "fine"])
@pytest.mark.parametrize(("case", "of_sag", "of_middle"), [(0, 0.02, 0.03), (1, 0.07, 0.08)], ids=["1 cm", "2 cm"])
@pytest.mark.parametrize("x", [0.0, 0.5e-3, 1.0e-3, 1.5e-3])
def test_a_bar_on_two_supports_sags_as_it_does_in_calculix(
    level: str, case: int, of_sag: float, of_middle: float, x: float
) -> None:
    """Wherever the supports touch between the contact samples.

    Cells of 6 to 12 mm do not show how a support of 5 mm presses into the bar: the middle stays a little higher.
    """
    right = np.array(ON_SUPPORTS["profile_m"])
    reference = ON_SUPPORTS["cases"][case]
    world, outcome = run(reference["bar"], plate_of(right[::-1] * [-1, 1], right), level=level, x=x, clamped=False)
    half, thickness = reference["bar"]["length"] / 2, reference["bar"]["thickness"]
    left, middle, end = world.points(outcome, np.array([[place, 0.0, thickness] for place in (-half, 0.0, half)]))[:, 2]
    assert (left + end) / 2 - middle == pytest.approx(reference["sag_m"], rel=of_sag)
    assert middle - thickness == pytest.approx(reference["middle_m"], rel=of_middle)


@pytest.mark.parametrize(("level", "error"), [("default", 0.08), ("fine", 0.03)])
@pytest.mark.parametrize("case", range(4))
def test_a_bar_clamped_on_a_table_droops_over_its_edge_as_in_calculix(level: str, error: float, case: int) -> None:
    """The clamp lifts part of the bar off the table: where it touches is part of the answer."""
    reference = OVER_EDGE["cases"][case]
    length = OVER_EDGE["bar"]["length"]
    table = plate_of(np.array(reference["profile_m"]))
    world, outcome = run(OVER_EDGE["bar"], table, level=level, x=length / 2, clamped=True)
    drop = world.shift(outcome)[world.end(0, 1), 2].mean()
    assert drop == pytest.approx(reference["tip_m"][1], rel=error)
