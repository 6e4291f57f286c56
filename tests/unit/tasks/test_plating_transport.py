"""How the outcome of a placement moves with the action."""

import numpy as np
import pytest

from common.domain.grid import Grid
from common.domain.heightmap import shift
from common.domain.scene import Item, Scene, State
from common.tasks.plating import Plating

GRID = Grid(40, 48, 0.004)
ACTION = np.array([0.0113, -0.0171])
NEAR = ACTION + np.array([[0.0, 0.0], [0.0021, 0.0], [-0.0013, 0.0047], [0.004, -0.008], [0.05, 0.05], [-0.09, 0.03]])


def a_state() -> State:
    x, y = GRID.x[None, :], GRID.y[:, None]
    item = np.maximum(0.018 * (1 - (x / 0.03) ** 2 - (y / 0.02) ** 2), 0)
    materials = np.where(item > 0, np.array([1000.0, 3e4, 0.4])[:, None, None], 0)
    scene = 0.01 * np.exp(-((x - 0.02) ** 2 + y**2) / 3e-4)
    return State(Scene(GRID, scene, np.zeros((3, *GRID.shape))), Item(item, materials))


STATE = a_state()
RNG = np.random.default_rng(0)
OUTCOME = (
    STATE.scene.heights
    + 0.9 * shift(STATE.item.heights, *(ACTION / GRID.cell))
    + 5e-4 * RNG.standard_normal(GRID.shape)
).astype(np.float32)
TRANSPORT = Plating().transport(STATE, ACTION, OUTCOME)


def formula(action: np.ndarray) -> np.ndarray:
    """Return ``m(a) shift(S_k, a - a_k) + (1 - m(a) - u) S_k + u I_0`` over the whole grid."""

    def mask(at: np.ndarray) -> np.ndarray:
        return np.clip(shift(STATE.item.heights, *(at / GRID.cell)) / 0.010, 0, 1)

    now, before = mask(action), mask(ACTION)
    left = np.maximum(before - now, 0)
    moved = shift(OUTCOME, *((action - ACTION) / GRID.cell))
    return now * moved + (1 - now - left) * OUTCOME + left * STATE.scene.heights


def test_the_simulated_action_gives_its_outcome_back_to_the_bit():
    np.testing.assert_array_equal(TRANSPORT.outcomes(ACTION[None])[0], OUTCOME)


def test_the_surface_moves_with_the_item_as_the_formula_says():
    expected = np.stack([formula(action) for action in NEAR])
    np.testing.assert_allclose(TRANSPORT.outcomes(NEAR), expected, atol=2e-8)


@pytest.mark.parametrize("count", [1, 3, len(NEAR)])
def test_rewards_are_those_of_the_outcomes(count: int):
    target = formula(np.array([0.0, -0.01]))
    expected = Plating().reward(TRANSPORT.outcomes(NEAR[:count]), target)
    np.testing.assert_allclose(TRANSPORT.rewards(NEAR[:count], target), expected, atol=1e-9)


def test_an_action_does_not_depend_on_those_beside_it():
    together = TRANSPORT.rewards(NEAR, STATE.scene.heights)
    alone = [float(TRANSPORT.rewards(action[None], STATE.scene.heights)[0]) for action in NEAR]
    np.testing.assert_allclose(together, alone, atol=1e-9)


def test_the_error_is_smallest_at_the_simulated_action_and_grows_with_the_distance():
    steps = np.array([0.0, 2e-4, 1e-3, 4e-3, 2e-2])
    errors = TRANSPORT.errors(ACTION + steps[:, None] * [0.6, 0.8])
    assert (np.diff(errors) > 0).all()
    assert errors[0] == pytest.approx(2.5e-5)
    assert errors[-1] == pytest.approx(0.027 * 0.02, rel=0.01)


def test_arguments_are_not_written_into():
    before = OUTCOME.copy(), NEAR.copy()
    TRANSPORT.rewards(NEAR, OUTCOME)
    TRANSPORT.outcomes(NEAR)
    np.testing.assert_array_equal(OUTCOME, before[0])
    np.testing.assert_array_equal(NEAR, before[1])
