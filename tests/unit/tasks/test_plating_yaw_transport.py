"""How the outcome of a placement moves and turns with the action."""

import numpy as np
import pytest

from common.domain.bodies import Material
from common.domain.deviation import deviation
from common.domain.grid import Grid
from common.domain.scene import Scene, State
from common.tasks import TASKS
from common.tasks.plating import Plating
from common.tasks.plating_items import RoundedRectangle, draw_item
from common.tasks.plating_turn import TurnedModel, turned_state
from services.heuristic import HeuristicModel
from tests.unit.tasks.test_plating_transport import ACTION, NEAR, OUTCOME, STATE

TASK = TASKS["plating_yaw"]


def with_yaw(actions: np.ndarray, yaw: float) -> np.ndarray:
    return np.column_stack([actions, np.full(len(actions), yaw)])


@pytest.mark.parametrize("yaw", [0.0, 0.7])
def test_where_yaws_are_equal_it_is_the_transport_of_plating_to_the_bit(yaw: float):
    turned = turned_state(STATE, yaw)
    plain = Plating().transport(turned, ACTION, OUTCOME)
    transport = TASK.transport(STATE, np.append(ACTION, yaw), OUTCOME)
    assert transport is not None
    actions = with_yaw(NEAR, yaw)
    np.testing.assert_array_equal(transport.outcomes(actions), plain.outcomes(NEAR))
    np.testing.assert_array_equal(transport.distances(actions), plain.distances(NEAR))


def sums(state: State, actions: np.ndarray) -> np.ndarray:
    return TurnedModel(HeuristicModel()).predict(state, actions).heights


@pytest.mark.parametrize("turn", [0.05, -0.2, 0.6])
def test_a_turned_surface_is_nearer_to_the_truth_than_one_left_lying(turn: float):
    # On a bare plate the heuristic's sum is the truth.
    bare = State(
        Scene(grid := Grid(80, 80, 0.0025), np.zeros(grid.shape), np.zeros((3, *grid.shape))),
        draw_item(grid, RoundedRectangle(0.13, 0.08, 0.02), thickness=0.018, material=Material(1050.0, 1e5, 0.4)),
    )
    before, after = np.array([[0.005, -0.01, 0.4]]), np.array([[0.007, -0.012, 0.4 + turn]])
    outcome, truth = sums(bare, before)[0], sums(bare, after)[0]
    transport = TASK.transport(bare, before[0], outcome)
    assert transport is not None
    lying = transport.outcomes(np.column_stack([after[:, :2], before[:, 2]]))[0]
    assert deviation(transport.outcomes(after)[0], truth) < 0.5 * deviation(lying, truth)


def test_in_a_window_it_is_the_outcome_s_part():
    transport = TASK.transport(STATE, np.append(ACTION, 0.2), OUTCOME)
    assert transport is not None
    actions = np.concatenate([with_yaw(NEAR[:4], 0.2), with_yaw(NEAR[:4], 0.35), with_yaw(NEAR[:4], -0.1)])
    window = transport.window(actions)
    np.testing.assert_allclose(transport.patches(actions, window), transport.outcomes(actions)[:, *window], atol=1e-8)


def test_a_surface_that_turned_with_the_item_is_the_same_in_its_frame():
    outcome = sums(STATE, np.array([[*ACTION, 0.7]]))[0] - STATE.scene.heights
    transport = TASK.transport(STATE, np.append(ACTION, 0.7), outcome)
    assert transport is not None
    thickness = STATE.item.heights[STATE.item.heights > 0]
    found = transport.aligned()
    assert found.shape == thickness.shape
    assert np.abs(found - thickness).mean() < 0.15 * thickness.mean()


def test_the_distance_grows_with_the_turn_either_way_as_the_item_s_points_go():
    transport = TASK.transport(STATE, np.append(ACTION, 3.0), OUTCOME)
    assert transport is not None
    turns = np.array([0.0, 0.01, 0.05, 0.2, 0.6])
    distances = transport.distances(np.column_stack([np.tile(ACTION, (5, 1)), 3.0 + turns]))
    assert (np.diff(distances) > 0).all()
    np.testing.assert_allclose(transport.distances(np.column_stack([np.tile(ACTION, (5, 1)), 3.0 - turns])), distances)
    rows, columns = np.nonzero(STATE.item.heights)
    gyration = np.sqrt((STATE.grid.x[columns] ** 2 + STATE.grid.y[rows] ** 2).mean())
    moved = ACTION + np.column_stack([gyration * turns, np.zeros(5)])
    np.testing.assert_allclose(distances, Plating().transport(STATE, ACTION, OUTCOME).distances(moved), rtol=1e-9)


def test_a_whole_turn_is_no_distance():
    transport = TASK.transport(STATE, np.append(ACTION, 3.1), OUTCOME)
    assert transport is not None
    across = transport.distances(np.array([[*ACTION, -3.1], [*ACTION, 3.1 + 2 * np.pi - 6.2]]))
    assert across[0] == pytest.approx(across[1])


def test_what_transports_of_one_state_share_changes_nothing():
    one, other = (
        TASK.transport(STATE, np.append(action, yaw), OUTCOME) for action, yaw in ((ACTION, 0.2), (NEAR[2], 0.35))
    )
    assert one is not None
    assert other is not None
    actions = np.concatenate([with_yaw(NEAR[:3], 0.2), with_yaw(NEAR[:3], 0.35)])
    window, shared = (slice(0, OUTCOME.shape[0]), slice(0, OUTCOME.shape[1])), {}
    for transport in (one, other):
        together = transport.patches(actions, window, shared)
        np.testing.assert_array_equal(together, transport.patches(actions, window))
