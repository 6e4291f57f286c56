import numpy as np
import pytest

from common.domain.bodies import Bodies, Box, Material
from common.domain.errors import ModelError, RequestError
from common.domain.grid import Grid
from common.domain.scene import State
from common.tasks.plating import Plating, dinner_plate, render_scene
from common.tasks.plating_sampler import (
    ATTEMPTS,
    ITEM_KINDS,
    LAYOUTS,
    MORE_KINDS,
    MORE_LAYOUTS,
    PLACES,
    sample_action,
    sample_fries,
    sample_item,
    sample_scene,
    sample_state,
)


def as_drawn(plate, boxes):
    return tuple(boxes)


def states(count):
    return [sample_state(np.random.default_rng(seed), Grid(), settle=as_drawn) for seed in range(count)]


@pytest.mark.parametrize(
    ("layout", "fewest"), [*((layout, 4) for layout in LAYOUTS), *((layout, 2) for layout in MORE_LAYOUTS)]
)
def test_fries_are_few_to_12_and_touch_neither_each_other_nor_the_plate(layout, fewest):
    for seed in range(10):
        plate = dinner_plate()
        boxes = sample_fries(np.random.default_rng(seed), plate, layout=layout)
        assert fewest <= len(boxes) <= 12
        for index, box in enumerate(boxes):
            below = _surface(plate, boxes[:index], _inside(box))
            assert (box.position[2] - box.size[2] / 2 > below).all()
            assert (box.size > (0.049, 0.0089, 0.0089)).all()
            assert (box.size < (0.071, 0.0111, 0.0111)).all()


def _inside(box):
    along, across = np.meshgrid(np.linspace(-0.5, 0.5, 61) * box.size[0], np.linspace(-0.5, 0.5, 11) * box.size[1])
    corners = np.stack([along.ravel(), across.ravel(), np.zeros(along.size)])
    return (box.rotation @ corners)[:2] + box.position[:2, None]


def _surface(plate, boxes, points):
    return np.max([plate.height(np.hypot(*points)), *(box.top(*points) for box in boxes)], axis=0)


@pytest.mark.parametrize("kind", ITEM_KINDS + MORE_KINDS)
@pytest.mark.parametrize("rigid", [False, True])
def test_items_have_the_thickness_and_material_of_their_class(kind, rigid):
    for seed in range(10):
        item = sample_item(np.random.default_rng(seed), Grid(), kind=kind, rigid=rigid)
        inside = item.heights[item.outline]
        assert 0.0119 < inside.min() <= inside.max() < 0.0261
        modulus = item.materials[1][item.outline]
        assert item.is_rigid == rigid
        assert ((modulus >= 1e8) if rigid else (modulus >= 5e3) & (modulus <= 1e6)).all()
        assert (item.materials[2][item.outline] >= 0.2).all()


def test_the_same_seed_draws_the_same_state_and_another_seed_another_one():
    first, second, other = (
        sample_state(np.random.default_rng(seed), Grid(), settle=as_drawn).digest for seed in (3, 3, 4)
    )
    assert first == second != other


@pytest.mark.parametrize("grid", [Grid(64, 64, 0.004), Grid(150, 140, 0.002)])
def test_states_are_drawn_on_the_grid_that_is_asked_for(grid):
    assert sample_state(np.random.default_rng(0), grid, settle=as_drawn).grid == grid


def test_a_scene_that_does_not_settle_or_loses_a_fry_is_drawn_again():
    failures = iter([ModelError("still moving"), "fallen"])

    def settle(plate, boxes):
        failure = next(failures, None)
        if isinstance(failure, ModelError):
            raise failure
        if failure == "fallen":
            lost = Box(boxes[0].size, np.array([0.2, 0, 0]), boxes[0].orientation, boxes[0].material)
            return (lost, *boxes[1:])
        return tuple(boxes)

    scene = sample_scene(np.random.default_rng(0), Grid(), settle=settle)
    assert all(np.hypot(*box.position[:2]) < 0.12 for box in scene.bodies.boxes)
    assert next(failures, "used up") == "used up"


def test_a_settler_that_always_fails_ends_in_an_error_with_its_reason():
    def settle(plate, boxes):
        raise ModelError("still moving at 5 mm/s")

    with pytest.raises(ModelError, match=rf"within {ATTEMPTS} draws, .*still moving at 5 mm/s"):
        sample_scene(np.random.default_rng(0), Grid(), settle=settle)


@pytest.mark.parametrize("place", [None, *PLACES])
def test_actions_lie_within_the_tasks_bounds(place):
    for state in states(3):
        low, high = Plating().bounds(state).T
        actions = np.array([sample_action(np.random.default_rng(seed), state, place=place) for seed in range(40)])
        assert (actions >= low).all()
        assert (actions <= high).all()


def test_bare_actions_put_the_item_beside_all_fries():
    fry = Box(
        np.array([0.06, 0.01, 0.01]), np.array([0, 0.06, 0.005]), np.array([0, 0, 0, 1.0]), Material(550, 1e6, 0.3)
    )
    scene = render_scene(Grid(), Bodies(dinner_plate(), (fry,)))
    item = sample_item(np.random.default_rng(0), Grid(), kind="medallion")
    state = State(scene, item)
    for seed in range(20):
        x, y = sample_action(np.random.default_rng(seed), state, place="bare")
        rows, columns = np.nonzero(item.outline)
        moved_x, moved_y = Grid().x[columns] + x, Grid().y[rows] + y
        assert not ((np.abs(moved_x) < 0.028) & (np.abs(moved_y - 0.06) < 0.003)).any()


def test_rim_actions_bring_the_items_far_end_onto_the_slope():
    state = states(1)[0]
    rows, columns = np.nonzero(state.item.outline)
    for seed in range(20):
        x, y = sample_action(np.random.default_rng(seed), state, place="rim")
        assert np.hypot(Grid().x[columns] + x, Grid().y[rows] + y).max() > 0.085


def test_heap_edge_actions_cover_a_fry():
    for state in states(3):
        rows, columns = np.nonzero(state.item.outline)
        fries = np.argwhere(state.scene.materials[0] > 0)
        for seed in range(10):
            action = sample_action(np.random.default_rng(seed), state, place="heap_edge")
            moved = np.stack([rows, columns], axis=1) + action[::-1] / Grid().cell
            nearest = np.abs(moved[:, None] - fries[None]).max(axis=2).min()
            assert nearest <= 1


def test_half_of_the_actions_and_more_are_near_heaps_or_rim():
    assert sum(PLACES.values()) == pytest.approx(1)
    assert PLACES["heap_edge"] + PLACES["rim"] > 0.5


@pytest.mark.parametrize(
    ("draw", "named"),
    [
        (lambda rng, state: sample_action(rng, state, place="moon"), "moon"),
        (lambda rng, state: sample_item(rng, Grid(), kind="soup"), "soup"),
        (lambda rng, state: sample_fries(rng, dinner_plate(), layout="tower"), "tower"),
    ],
)
def test_an_unknown_name_is_refused_with_the_known_ones(draw, named):
    with pytest.raises(RequestError, match=f"expected .*, .* got '{named}'"):
        draw(np.random.default_rng(0), states(1)[0])
