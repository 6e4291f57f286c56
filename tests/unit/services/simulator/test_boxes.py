from collections.abc import Callable

import numpy as np
import pytest
import warp as wp

from common.domain.bodies import Box, Plate
from common.domain.errors import ModelError
from common.tasks.plating import dinner_plate
from services.simulator.bodies import box_body
from services.simulator.settings import Settings
from services.simulator.settle import settle_boxes
from services.simulator.simulation import Simulation

Make = Callable[..., Box]
World = Callable[..., Simulation]
FRICTION_ANGLE = float(np.arctan(Settings().friction))


def test_a_box_comes_to_rest_lying_on_the_plate(fry: Make) -> None:
    (settled,) = settle_boxes(dinner_plate(), [fry(0, 0, 0.012, 0.3)])
    assert settled.position == pytest.approx([0, 0, 0.005], abs=2e-5)
    assert settled.orientation == pytest.approx([0, 0, np.sin(0.15), np.cos(0.15)], abs=1e-4)


def test_no_boxes_are_at_rest() -> None:
    assert settle_boxes(dinner_plate(), []) == ()


def test_crossed_fries_stay_stacked(fry: Make) -> None:
    stack = [fry(0, y, 0.006, 0) for y in (-0.02, 0.02)] + [fry(x, 0, 0.0165, np.pi / 2) for x in (-0.02, 0.02)]
    settled = settle_boxes(dinner_plate(), stack)
    assert [box.position[2] for box in settled] == pytest.approx([0.005, 0.005, 0.015, 0.015], abs=1e-4)


def test_a_heap_on_the_slope_of_the_rim_is_truly_at_rest(fry: Make) -> None:
    rng = np.random.default_rng(4)
    heap = [fry(0.08 + 0.01 * rng.normal(), 0.01 * rng.normal(), 0.03 + 0.015 * i, rng.uniform(0, 3)) for i in range(6)]
    settled = list(settle_boxes(dinner_plate(), heap))
    simulation = Simulation(
        plate=dinner_plate(),
        mesh=None,
        samples=None,
        bodies=[box_body(box, Settings()) for box in settled],
        settings=Settings(),
    )
    simulation.place(
        np.zeros((1, 0, 3)),
        np.array([[box.position for box in settled]]),
        np.array([[box.orientation for box in settled]]),
    )
    assert simulation.run().settled[0]
    assert simulation.verify_rest()[0] < 3e-3


def test_boxes_that_have_no_time_to_settle_are_an_error_that_says_how_fast_they_are(fry: Make) -> None:
    with pytest.raises(
        ModelError, match=r"expected 1 boxes to come to rest within 0.02 s, got a speed of [1-9][0-9.]* mm/s"
    ):
        settle_boxes(dinner_plate(), [fry(0, 0, 0.1)], settings=Settings(longest_time=0.02))


@pytest.mark.parametrize("yaw", [0.0, np.pi / 2])
def test_a_box_on_a_slope_holds_below_the_friction_angle_and_slides_above(
    fry: Make, box_world: World, yaw: float
) -> None:
    box = fry(0, 0, 0.005, yaw)
    speeds = []
    for slope in (FRICTION_ANGLE - np.radians(1), FRICTION_ANGLE + np.radians(1)):
        simulation = box_world([box], slope=float(slope))
        simulation.run()
        speeds.append(simulation.verify_rest()[0])
    assert speeds[0] < 3e-4
    assert speeds[1] > 1e-2


def test_a_tall_box_tips_beyond_the_angle_at_which_its_weight_leaves_its_base(fry: Make, box_world: World) -> None:
    tall = fry(0, 0, 0.015, size=(0.01, 0.01, 0.03))
    upright = []
    for tangent in (0.22, 0.25):  # the flat base ends ROUNDING before the edge: (5 - 1.5) / 15 = 0.233
        simulation = box_world([tall], slope=float(np.arctan(tangent)))
        upright.append(abs(simulation.run().orientations[0, 0, 1]) < 0.1)
    assert upright == [True, False]


def test_momentum_of_a_free_body_is_kept_and_it_falls_as_it_should(fry: Make, box_world: World) -> None:
    settings = Settings(first_step=0.001, shortest_step=0.001, longest_time=0.1)
    simulation = box_world([fry(0, 0, 0.5)], undamped=True, settings=settings)
    simulation.worlds.pv.fill_(wp.vec3(0.3, -0.2, 0.0))
    outcome = simulation.run()
    time = float(outcome.time[0])
    assert outcome.positions[0, 0, :2] == pytest.approx([0.3 * time, -0.2 * time], rel=1e-3)
    assert outcome.positions[0, 0, 2] == pytest.approx(0.5 - 9.81 / 2 * time**2, abs=9.81 / 2 * time * 0.0011)


def test_energy_never_grows_without_input(fry: Make, box_world: World) -> None:
    boxes = [fry(0, 0, 0.02, 0.4), fry(0.005, 0, 0.035, 1.4)]
    highest = np.inf
    for time in (0.05, 0.1, 0.15, 0.2):
        settings = Settings(first_step=0.005, shortest_step=0.005, longest_time=time, iterations=8)
        simulation = box_world(boxes, undamped=True, settings=settings)
        outcome = simulation.run()
        velocity = simulation.worlds.pv.numpy()[0]
        energy = float((9.81 * outcome.positions[0, :, 2] + (velocity**2).sum(axis=1) / 2).sum())
        assert energy <= highest + 1e-3
        highest = energy


def test_the_table_catches_what_falls_off_the_plate(fry: Make) -> None:
    plate = dinner_plate()
    (settled,) = settle_boxes(plate, [fry(0.17, 0, 0.02)])
    assert settled.position[2] == pytest.approx(plate.heights[-1] + 0.005, abs=2e-5)


def test_a_plate_of_another_profile_comes_with_the_scene(fry: Make) -> None:
    bowl = Plate(np.linspace(0, 0.12, 25), np.linspace(0, 0.12, 25) ** 2 * 3)
    (settled,) = settle_boxes(bowl, [fry(0.0, 0, 0.03)])
    assert 0.005 < settled.position[2] < 0.012
