"""What cannot be true of an executed action is refused, and says why."""

import numpy as np
import pytest

from common.domain.errors import RequestError
from common.domain.executed import LEAST_CHANGE, added_volume, check_executed, item_volume
from common.domain.grid import Floats, Grid
from common.domain.heightmap import shift
from common.domain.scene import Item, Scene, State
from common.tasks import TASKS

GRID = Grid(16, 16, 0.01)
ACTION = (0.02, -0.01)


def a_state(*, thickness: float = 0.01, height: float = 0.0) -> State:
    scene, item = np.full(GRID.shape, height, dtype=np.float32), np.zeros(GRID.shape, dtype=np.float32)
    item[6:10, 6:10] = thickness
    materials = np.zeros((3, *GRID.shape), dtype=np.float32)
    materials[:, item > 0] = np.array([[1000.0], [1e5], [0.4]])
    return State(Scene(GRID, scene, np.zeros_like(materials)), Item(item, materials))


def placed(state: State, *, times: float = 1.0) -> Floats:
    return state.scene.heights + times * shift(state.item.heights, ACTION[0] / GRID.cell, ACTION[1] / GRID.cell)


def test_an_item_that_lies_where_it_was_placed_is_believed():
    state = a_state()
    outcome = check_executed(TASKS["plating"], state, ACTION, placed(state))
    assert outcome.dtype == np.float32
    assert not outcome.flags.writeable
    assert item_volume(state) == pytest.approx(16 * 0.01 * 1e-4)
    assert added_volume(state, outcome) == pytest.approx(item_volume(state), rel=1e-5)


@pytest.mark.parametrize("times", [0.21, 4.9])
def test_an_outcome_may_add_much_less_or_more_than_the_item(times: float):
    state = a_state()
    check_executed(TASKS["plating"], state, ACTION, placed(state, times=times))


@pytest.mark.parametrize("times", [0.19, 5.1, -1.0])
def test_an_outcome_that_cannot_be_the_item_is_refused(times: float):
    state = a_state()
    with pytest.raises(
        RequestError, match=r"outcome: expected 0.2 to 5 times the item's volume .*, got .* times 16 cm3"
    ):
        check_executed(TASKS["plating"], state, ACTION, placed(state, times=times))


@pytest.mark.parametrize("noise", [0.0, 0.9 * LEAST_CHANGE])
def test_an_outcome_that_is_the_scene_is_refused(noise: float):
    state = a_state()
    with pytest.raises(RequestError, match=r"outcome: expected a mean difference .* was nothing placed"):
        check_executed(TASKS["plating"], state, ACTION, state.scene.heights + np.float32(noise))


@pytest.mark.parametrize(("name", "state"), [("scene", a_state(height=-0.6)), ("item", a_state(thickness=0.6))])
def test_heights_of_another_unit_are_refused(name: str, state: State):
    with pytest.raises(RequestError, match=rf"{name}: expected heights within 0\.5 m, got 0.6 m"):
        check_executed(TASKS["plating"], state, ACTION, np.zeros(GRID.shape))


@pytest.mark.parametrize(
    ("change", "reason"),
    [
        (lambda heights: 60 * heights, "outcome: expected heights within 0.5 m, got 0.6 m"),
        (lambda heights: 1e3 * heights, "outcome: expected heights of at most 1 m, got 10 m"),
        (lambda heights: heights[:, :8], r"outcome: expected shape \(16, 16\), got \(16, 8\)"),
        (lambda heights: np.where(heights > 0, np.nan, heights), "outcome: expected finite numbers"),
        (lambda heights: np.where(heights > 0, np.inf, heights), "outcome: expected finite numbers"),
    ],
)
def test_an_outcome_that_is_no_heightmap_in_metres_is_refused(change, reason: str):
    state = a_state()
    with pytest.raises(RequestError, match=reason):
        check_executed(TASKS["plating"], state, ACTION, change(placed(state)))


@pytest.mark.parametrize(
    ("task", "action", "reason"),
    [
        ("plating", (0.061, 0.0), "expected x between -0.06 and 0.06 m, got 0.061"),
        ("plating", (0.0, -0.07), "expected y between -0.06 and 0.06 m, got -0.07"),
        ("plating", (float("nan"), 0.0), "expected x between"),
        ("plating", (0.0,), "expected x, y as plating has it, got 1 numbers"),
        ("plating", (0.0, 0.0, 0.0), "expected x, y as plating has it, got 3 numbers"),
        ("plating_yaw", (0.0, 0.0, 3.2), "expected yaw between -3.14159 and 3.14159 rad, got 3.2"),
    ],
)
def test_an_action_that_the_task_does_not_have_is_refused(task: str, action: tuple[float, ...], reason: str):
    state = a_state()
    with pytest.raises(RequestError, match=f"action: {reason}"):
        check_executed(TASKS[task], state, action, placed(state))


def test_an_action_on_the_bounds_in_single_precision_is_the_task_s():
    state = a_state()
    action = (*map(float, np.float32([0.06, -0.06])), float(np.float32(np.pi)))
    assert action[2] > np.pi
    check_executed(TASKS["plating_yaw"], state, action, placed(state))
