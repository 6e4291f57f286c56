"""Turning the item."""

import numpy as np
import pytest

from common.domain.bodies import Material
from common.domain.errors import RequestError
from common.domain.grid import Grid
from common.domain.scene import Item, Scene, State
from common.tasks import TASKS
from common.tasks.plating_items import RoundedRectangle, Wavy, draw_item
from common.tasks.plating_turn import TurnedEstimator, TurnedModel, turned_heights, turned_item, turned_state
from services.heuristic import HeuristicModel
from tests.fakes import Radius, Tilted

GRID = Grid(80, 80, 0.0025)
MEAT = Material(1050.0, 1e5, 0.4)
STEAK = RoundedRectangle(0.13, 0.08, 0.02)
IRREGULAR = Wavy(0.12, 0.08, (0.08, -0.06, 0.04), (0.3, 1.2, 2.0))
YAWS = [0.001, 0.3, np.pi / 4, 1.9, -2.5, 3.1]


def drawn(outline, angle: float = 0.0, **options) -> Item:
    return draw_item(GRID, outline, thickness=0.018, material=MEAT, angle=angle, **options)


def a_state(item: Item) -> State:
    return State(Scene(GRID, np.zeros(GRID.shape), np.zeros((3, *GRID.shape))), item)


def edge(item: Item):
    """Return the cells of an outline's edge and those beside them."""
    padded = np.pad(item.outline, 1)
    around = [padded[r : r + GRID.rows, c : c + GRID.columns] for r in range(3) for c in range(3)]
    return np.logical_or.reduce(around) & ~np.logical_and.reduce(around)


def test_at_yaw_0_nothing_is_copied_or_changed():
    item = drawn(STEAK)
    assert turned_item(item, GRID, 0.0) is item
    assert turned_state(a_state(item), 0.0).digest == a_state(item).digest


@pytest.mark.parametrize("turns", [1, 2, 3, -1])
def test_quarter_turns_are_exact_and_counter_clockwise(turns: int):
    item = drawn(IRREGULAR, taper=(0.2, 0.1))
    turned = turned_item(item, GRID, turns * np.pi / 2)
    # Rows grow along y: from x to y is a clockwise turn of the array as it is printed.
    np.testing.assert_allclose(turned.heights, np.rot90(item.heights, -turns), rtol=1e-6)
    np.testing.assert_array_equal(turned.materials, np.rot90(item.materials, -turns, axes=(1, 2)))


def test_a_point_on_the_x_axis_turns_to_the_y_axis():
    heights = np.zeros(GRID.shape, dtype=np.float32)
    heights[39:41, 70] = 0.01
    rows, columns = np.nonzero(turned_heights(heights, GRID, np.pi / 2))
    assert set(columns) == {39, 40}
    assert set(rows) == {70}


@pytest.mark.parametrize("yaw", YAWS)
@pytest.mark.parametrize("outline", [STEAK, IRREGULAR])
def test_it_is_the_item_that_is_drawn_at_that_angle_but_for_cells_at_its_edge(outline, yaw: float):
    turned, expected = turned_item(drawn(outline), GRID, yaw), drawn(outline, yaw)
    differs = turned.outline != expected.outline
    assert not (differs & ~edge(expected)).any()
    assert differs.sum() < 0.25 * edge(expected).sum()
    np.testing.assert_allclose(turned.heights[turned.outline], 0.018, rtol=1e-5)


@pytest.mark.parametrize("yaw", YAWS)
def test_mass_and_area_stay_within_one_percent(yaw: float):
    item = drawn(IRREGULAR, taper=(0.2, 0.1))
    turned = turned_item(item, GRID, yaw)
    assert turned.outline.sum() == pytest.approx(item.outline.sum(), rel=0.01)
    for one in (0, 1, 2):
        expected = (item.materials[one] * item.heights).sum()
        assert (turned.materials[one] * turned.heights).sum() == pytest.approx(expected, rel=0.01)


@pytest.mark.parametrize("yaw", YAWS)
def test_materials_do_not_blend(yaw: float):
    item = drawn(STEAK)
    materials = item.materials.copy()
    bone = np.abs(GRID.x[None, :]) < 0.01
    materials[:, bone & item.outline] = np.array([1800.0, 1e9, 0.3])[:, None]
    turned = turned_item(Item(item.heights, materials), GRID, yaw)
    kinds = {tuple(kind) for kind in materials.reshape(3, -1).T.tolist()}
    assert {tuple(kind) for kind in turned.materials.reshape(3, -1).T.tolist()} == kinds
    assert (turned.materials[0][turned.outline] > 0).all()
    assert not turned.materials[:, ~turned.outline].any()
    share = (turned.materials[1] == 1e9).sum() / turned.outline.sum()
    assert share == pytest.approx((materials[1] == 1e9).sum() / item.outline.sum(), rel=0.05)


@pytest.mark.parametrize("yaw", YAWS)
def test_heights_alone_are_those_of_the_item(yaw: float):
    item = drawn(IRREGULAR, taper=(0.2, 0.1))
    np.testing.assert_array_equal(turned_heights(item.heights, GRID, yaw), turned_item(item, GRID, yaw).heights)


def test_an_item_that_does_not_fit_once_it_is_turned_is_the_callers_fault():
    grid = Grid(40, 80, 0.0025)
    item = draw_item(grid, RoundedRectangle(0.15, 0.06, 0.01), thickness=0.01, material=MEAT)
    turned_item(item, grid, 0.1)
    with pytest.raises(RequestError, match="yaw: expected an item that fits"):
        turned_item(item, grid, np.pi / 2)


class Counting(HeuristicModel):
    """Counts the batches that it is asked."""

    def __init__(self) -> None:
        self.batches: list[int] = []

    def outcomes(self, state, actions):
        self.batches.append(len(actions))
        return super().outcomes(state, actions)


ACTIONS = np.array([[0.01, 0.0, 0.5], [0.0, 0.02, -1.0], [-0.01, 0.01, 0.5], [0.0, 0.0, 0.0], [0.02, 0.0, -1.0]])


def test_each_yaw_of_a_batch_is_asked_once_and_answers_come_back_in_order():
    inner, state = Counting(), a_state(drawn(IRREGULAR))
    together = TurnedModel(inner).predict(state, ACTIONS).heights
    assert sorted(inner.batches) == [1, 2, 2]
    for heights, action in zip(together, ACTIONS, strict=True):
        turned = turned_state(state, float(action[2]))
        np.testing.assert_array_equal(heights, HeuristicModel().predict(turned, action[None, :2]).heights[0])


def test_estimates_come_back_in_order_too():
    estimates = TurnedEstimator(Radius()).estimate(a_state(drawn(STEAK)), ACTIONS)
    expected = Radius().estimate(a_state(drawn(STEAK)), ACTIONS[:, :2])
    for name in ("mean", "upper", "familiar"):
        np.testing.assert_array_equal(getattr(estimates, name), getattr(expected, name))


@pytest.mark.parametrize("count", [1, 2, 4])
def test_another_number_of_parameters_is_the_callers_fault(count: int):
    model = TASKS["plating_yaw"].adapt_model(HeuristicModel())
    with pytest.raises(RequestError, match=rf"expected 3 \(x, y, yaw\) parameters each, got {count}"):
        model.predict(a_state(drawn(STEAK)), np.zeros((1, count)))
    estimator = TASKS["plating_yaw"].adapt_estimator(Radius())
    with pytest.raises(RequestError, match=rf"expected 3 \(x, y, yaw\) parameters each, got {count}"):
        estimator.estimate(a_state(drawn(STEAK)), np.zeros((1, count)))


def test_plating_refuses_a_model_that_needs_a_yaw_and_yaw_one_that_takes_something_else():
    with pytest.raises(RequestError, match=r"expected one that takes \(x, y\) in plating, got \(x, y, yaw\)"):
        TASKS["plating"].adapt_model(TurnedModel(HeuristicModel()))
    odd = Tilted()
    odd.takes = (("force",),)
    with pytest.raises(RequestError, match=r"expected one that takes \(x, y, yaw\) in plating_yaw, got \(force\)"):
        TASKS["plating_yaw"].adapt_model(odd)
