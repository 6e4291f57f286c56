"""The world's stand-in, and what the robot makes of what it sees of it."""

from dataclasses import replace

import numpy as np
import pytest

from common.domain.errors import RequestError
from common.domain.grid import Grid
from common.tasks.plating import dinner_plate
from pipelines.data.depth_case import perceive
from pipelines.data.plate_pose import align
from services.simulator.model import SimulatorModel
from services.world.optics import EDGE, UNIT, Optics
from services.world.steaks import STEAKS, draw_steak
from services.world.world import OPTICS, StandIn

CROWDED = 6
"""A table on which fries that are found in the heightmap overlap at first."""


@pytest.fixture(scope="module")
def world() -> StandIn:
    return StandIn()


def see(world, table):
    return perceive(world.look(table), grid=Grid())


def bare_plate(x, y):
    return dinner_plate().height(np.hypot(x, y))


def test_there_are_four_soft_and_two_rigid_steaks():
    assert [steak.is_rigid for steak in STEAKS] == [False] * 4 + [True] * 2
    assert all(draw_steak(steak, Grid(), yaw=0.3).is_rigid == steak.is_rigid for steak in STEAKS)


def test_the_same_table_and_action_look_the_same_and_another_one_does_not(world):
    first, again = world.look(1), StandIn().look(1)
    np.testing.assert_array_equal(first.before, again.before)
    np.testing.assert_array_equal(world.execute(1, (0.01, 0.02)), StandIn().execute(1, (0.01, 0.02)))
    assert (first.before != world.look(2).before).any()
    assert (world.execute(1, (0.01, 0.02)) != world.execute(1, (0.011, 0.02))).any()


def test_an_image_has_noise_holes_and_edges_that_bleed():
    clean = replace(OPTICS, noise=0.0, drift=0.0, speckle=0.0, lost_edges=0.0, bleeding=0.0, blobs=(0, 1, 1))
    ideal = clean.see(bare_plate, np.random.default_rng(0)) * UNIT
    seen = OPTICS.see(bare_plate, np.random.default_rng(0)) * UNIT
    known, steep = seen > 0, np.zeros(seen.shape, dtype=bool)
    steep[:-1] |= np.abs(np.diff(ideal, axis=0)) > EDGE
    steep[1:] |= steep[:-1].copy()
    error = (seen - ideal)[known & ~steep]
    assert 0.01 < (~known).mean() < 0.05
    assert OPTICS.noise * 0.9 < np.percentile(np.abs(error), 68) < 1.6 * OPTICS.noise
    assert np.abs((seen - ideal)[known]).max() > EDGE / 2


def test_a_calibration_that_is_a_little_wrong_is_put_right_by_the_empty_plate():
    seen = OPTICS.see(bare_plate, np.random.default_rng(3)) * UNIT
    camera, plate = align(seen, OPTICS.calibrated, dinner_plate())
    wrong = np.linalg.norm(OPTICS.calibrated.position - OPTICS.camera.position)
    assert wrong > 0.0015
    assert np.linalg.norm(camera.position - OPTICS.camera.position) < 0.0005
    tilted = camera.rotation @ OPTICS.camera.rotation.T @ [0, 0, 1]
    assert np.hypot(*tilted[:2]) < np.hypot(*OPTICS.turn[:2]) / 3
    assert (
        np.abs(plate.height(np.linspace(0, 0.115, 50)) - dinner_plate().height(np.linspace(0, 0.115, 50))).max() < 5e-4
    )


def test_a_plate_that_is_elsewhere_is_refused():
    moved = replace(OPTICS.camera, position=OPTICS.camera.position + np.array([0.06, 0, 0]))
    with pytest.raises(RequestError, match="expected it within 30 mm of where the pose says"):
        align(OPTICS.see(bare_plate, np.random.default_rng(3)) * UNIT, moved, dinner_plate())


def test_an_image_without_a_plate_is_refused():
    with pytest.raises(RequestError, match="pixels of it in the image, got 0"):
        align(np.zeros(Optics().shape), OPTICS.camera, dinner_plate())


@pytest.mark.parametrize("table", [0, 4])
def test_the_robot_perceives_outline_thickness_and_fries(world, table):
    state = see(world, table).state
    steak, true = world._table(table)
    fine = true.item.outline.sum() * 0.0015**2
    assert state.item.outline.sum() * 0.003**2 == pytest.approx(fine, rel=0.06)
    inside = state.item.heights[state.item.heights > 0.008]
    assert inside.mean() == pytest.approx(float(true.item.heights[true.item.heights > 0.008].mean()), abs=0.0008)
    assert state.item.is_rigid == steak.is_rigid
    fries = true.scene.materials[0].reshape(96, 2, 96, 2).max(axis=(1, 3)) > 0
    seen = state.scene.materials[0] > 0
    assert (fries & seen).sum() > 0.85 * max(fries.sum(), seen.sum())


def test_what_the_robot_put_down_is_near_where_it_was_told_to(world):
    perceived, action = see(world, 3), (0.0, 0.045)
    outcome = perceived.outcome(world.execute(3, action))
    change = np.clip(outcome - perceived.state.scene.heights, 0, None)
    grid = perceived.state.grid
    centre = (change * grid.x).sum() / change.sum(), (change * grid.y[:, None]).sum() / change.sum()
    assert np.hypot(centre[0] - action[0], centre[1] - action[1]) < 0.004


def test_fries_that_overlap_as_found_are_parted_before_they_are_simulated(world):
    state = see(world, CROWDED).state
    assert SimulatorModel().predict(state, np.array([[0.0, 0.0]])).warnings == ("",)


@pytest.mark.parametrize("action", [(0.2, 0.0), (np.nan, 0.0)])
def test_an_action_off_the_plate_is_refused(world, action):
    with pytest.raises(RequestError, match=r"expected one within 0.1 m of the plate's centre"):
        world.execute(0, action)
