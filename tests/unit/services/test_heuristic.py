"""The paper's Algorithm 1."""

import numpy as np
import pytest

from common.domain.errors import RequestError
from common.domain.scene import State
from services.heuristic import HeuristicModel
from tests.unit.domain.test_scene import GRID, a_scene, an_item

STATE = State(a_scene(), an_item())


def test_at_whole_cells_the_prediction_is_scene_plus_item_exactly():
    action = np.array([[0.03, -0.02]])
    expected = STATE.scene.heights + np.roll(STATE.item.heights, (-2, 3), axis=(0, 1))
    np.testing.assert_array_equal(HeuristicModel().predict(STATE, action).heights[0], expected)


def test_between_cells_the_added_volume_is_kept():
    added = HeuristicModel().predict(STATE, np.array([[0.0137, 0.0041]])).heights[0] - STATE.scene.heights
    assert added.sum() == pytest.approx(STATE.item.heights.sum(), rel=1e-5)


def test_every_action_of_a_batch_is_predicted_as_if_alone():
    actions = np.random.default_rng(1).uniform(-0.05, 0.05, (7, 2))
    together = HeuristicModel().predict(STATE, actions).heights
    alone = np.concatenate([HeuristicModel().predict(STATE, action[None]).heights for action in actions])
    np.testing.assert_array_equal(together, alone)


@pytest.mark.parametrize("actions", [np.zeros(2), np.zeros((0, 2)), np.full((1, 2), np.nan)])
def test_senseless_actions_are_refused(actions: np.ndarray):
    with pytest.raises(RequestError, match="actions: expected"):
        HeuristicModel().predict(STATE, actions)


def test_the_grid_of_the_prediction_is_the_states():
    assert HeuristicModel().predict(STATE, np.zeros((2, 2))).heights.shape == (2, *GRID.shape)
