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
def test_in_a_window_it_is_the_outcome_s_part(count: int):
    rows, columns = TRANSPORT.window(NEAR)
    larger = slice(max(rows.start - 2, 0), rows.stop), columns
    expected = TRANSPORT.outcomes(NEAR[:count])[:, *larger]
    np.testing.assert_allclose(TRANSPORT.patches(NEAR[:count], larger), expected, atol=1e-8)


def test_an_action_does_not_depend_on_those_beside_it():
    alone = np.concatenate([TRANSPORT.outcomes(action[None]) for action in NEAR])
    np.testing.assert_allclose(TRANSPORT.outcomes(NEAR), alone, atol=1e-8)


def test_the_distance_is_that_between_the_actions():
    steps = np.array([0.0, 2e-4, 1e-3, 4e-3, 2e-2])
    np.testing.assert_allclose(TRANSPORT.distances(ACTION + steps[:, None] * [0.6, 0.8]), steps, atol=1e-12)


def test_outcomes_that_moved_with_the_item_are_the_same_in_its_frame():
    whole = np.array([2, -3]) * GRID.cell
    item = shift(STATE.item.heights, *(ACTION / GRID.cell))
    there = shift(STATE.item.heights, *((ACTION + whole) / GRID.cell))
    one, other = (
        Plating().transport(STATE, action, heights) for action, heights in ((ACTION, item), (ACTION + whole, there))
    )
    np.testing.assert_allclose(one.aligned(), other.aligned(), atol=1e-8)
    assert len(one.aligned()) == (STATE.item.heights > 0).sum()
    thickness = STATE.item.heights[STATE.item.heights > 0]
    assert np.abs(one.aligned() - thickness).mean() < 0.1 * thickness.mean()


def test_arguments_are_not_written_into():
    before = OUTCOME.copy(), NEAR.copy()
    TRANSPORT.outcomes(NEAR)
    TRANSPORT.aligned()
    np.testing.assert_array_equal(OUTCOME, before[0])
    np.testing.assert_array_equal(NEAR, before[1])
