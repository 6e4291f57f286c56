from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest

from common.domain.bodies import Bodies, Box
from common.domain.errors import RequestError
from common.domain.grid import Grid
from common.domain.heightmap import shift
from common.domain.scene import Item, State
from common.tasks.plating import dinner_plate
from services.simulator.model import SimulatorModel
from services.simulator.settings import LEVELS, Settings
from services.simulator.settle import settle_boxes

Slab = Callable[..., Item]
Fry = Callable[..., Box]
Make = Callable[..., State]


@pytest.fixture(scope="module")
def model() -> SimulatorModel:
    return SimulatorModel()


@pytest.fixture
def heap(fry: Fry) -> tuple[Box, ...]:
    return settle_boxes(
        dinner_plate(), [fry(0, 0, 0.006, 0.2), fry(0.01, 0.01, 0.018, 1.5), fry(-0.02, 0.0, 0.03, 0.9)]
    )


@pytest.mark.parametrize("youngs_modulus", [2e4, 1e6, 1e9])
def test_a_flat_placement_is_the_scene_plus_the_shifted_item(
    model: SimulatorModel, slab: Slab, state_of: Make, youngs_modulus: float
) -> None:
    state = state_of(slab(youngs_modulus=youngs_modulus))
    predictions = model.predict(state, np.array([[0.006, -0.009]]))
    expected = state.scene.heights + shift(state.item.heights, 2, -3)
    compression = 1050 * 9.81 * 0.02**2 / 2 / youngs_modulus
    bulge = 0.3 * 1050 * 9.81 * 0.02 / youngs_modulus * 0.045  # Poisson's expansion moves the outline by this at most
    difference = np.abs(predictions.heights[0] - expected)
    assert predictions.warnings == ("",)
    assert difference[26:36, 23:33].max() < compression * 1.1 + 2e-5
    assert difference.max() < compression * 1.1 + 2e-5 + bulge / 0.003 * 0.02


@pytest.mark.parametrize("youngs_modulus", [1e6, 1e9])
@pytest.mark.parametrize("action", [(0.0011, 0.0), (0.0, -0.0004), (0.0029, 0.0016)])
def test_a_flat_item_between_cells_covers_them_by_their_shares(
    model: SimulatorModel, slab: Slab, state_of: Make, youngs_modulus: float, action: tuple[float, float]
) -> None:
    state = state_of(slab(youngs_modulus=youngs_modulus))
    expected = state.scene.heights + shift(state.item.heights, action[0] / 0.003, action[1] / 0.003)
    difference = model.predict(state, np.array([action])).heights[0] - expected
    # 64 points a cell, each alone in its column and row: an edge is off by 1/64 of the item's height, and a corner
    # and the friction that stops the item a little short by as much again
    assert np.abs(difference).max() < 0.02 / 64 * 3


def test_the_outcome_changes_as_little_as_the_action_where_nothing_rolls(
    model: SimulatorModel, slab: Slab, state_of: Make
) -> None:
    state = state_of(slab(youngs_modulus=1e6))
    near, far = model.predict(state, np.array([[0.0, 0.0], [1e-4, 0.0]])).heights
    assert np.sqrt(np.mean((near - far) ** 2)) < 1e-4


def test_a_soft_block_is_compressed_by_its_own_weight_as_theory_says(
    model: SimulatorModel, slab: Slab, state_of: Make
) -> None:
    state = state_of(slab(24, 24, thickness=0.024, youngs_modulus=2e4))
    state = State(state.scene, replace(state.item, materials=state.item.materials * np.array([1, 1, 0])[:, None, None]))
    top = model.predict(state, np.zeros((1, 2))).heights[0][28:36, 28:36]
    compression = 1050 * 9.81 * 0.024**2 / 2 / 2e4
    sunk = 2e-5  # the depth at which the contact carries the weight
    assert 0.024 - top == pytest.approx(np.full(top.shape, compression), rel=0.003, abs=sunk)


def test_a_soft_item_drapes_over_a_fry_and_a_rigid_one_leans(
    model: SimulatorModel, slab: Slab, state_of: Make, fry: Fry
) -> None:
    boxes = settle_boxes(dinner_plate(), [fry(0.03, 0, 0.006, np.pi / 2)])
    soft, rigid = (
        model.predict(state_of(slab(youngs_modulus=modulus), boxes), np.zeros((1, 2))) for modulus in (1e4, 1e9)
    )
    assert soft.warnings == rigid.warnings == ("",)
    assert soft.heights[0, 32, 17:24].max() < 0.021
    profile = rigid.heights[0, 32, 18:38].astype(float)
    assert np.abs(np.diff(profile, 2)).max() < 1e-4
    assert np.diff(profile).min() > 2e-4


@pytest.mark.parametrize("youngs_modulus", [5e4, 1e9])
def test_the_same_request_gives_the_same_bits_alone_in_a_batch_and_in_another_model(
    model: SimulatorModel, slab: Slab, state_of: Make, heap: tuple[Box, ...], youngs_modulus: float
) -> None:
    state = state_of(slab(youngs_modulus=youngs_modulus), heap)
    actions = np.array([[0.011, 0.002], [-0.02, 0.03]])
    batch = model.predict(state, actions).heights
    assert np.array_equal(model.predict(state, actions[1:]).heights[0], batch[1])
    assert np.array_equal(SimulatorModel().predict(state, actions[:1]).heights[0], batch[0])


def test_worlds_run_together_end_as_they_do_alone(slab: Slab, state_of: Make, heap: tuple[Box, ...]) -> None:
    from services.simulator.placement import Placement

    state = state_of(slab(), heap)
    assert state.scene.bodies is not None
    actions = np.array([[0.011, 0.002], [-0.02, 0.03], [0.05, 0.0]])
    alone, together = (
        Placement(state, state.scene.bodies, settings=Settings(), worlds=worlds, device="cpu") for worlds in (1, 3)
    )
    apart = np.concatenate([alone.run(action[None]).heights for action in actions])
    assert np.array_equal(together.run(actions).heights, apart)


def test_a_mirrored_scene_gives_the_mirrored_outcome(
    model: SimulatorModel, slab: Slab, state_of: Make, fry: Fry
) -> None:
    def mirrored(box: Box) -> Box:
        x, y, z, w = box.orientation
        return Box(box.size, box.position * [-1, 1, 1], np.array([x, -y, -z, w]), box.material)

    box = settle_boxes(dinner_plate(), [fry(0.02, 0.01, 0.006, 0.7)])[0]
    item = slab(youngs_modulus=1e5)
    here = model.predict(state_of(item, (box,)), np.array([[0.03, 0.01]])).heights[0]
    there = model.predict(state_of(item, (mirrored(box),)), np.array([[-0.03, 0.01]])).heights[0]
    assert np.sqrt(((here - there[:, ::-1]) ** 2).mean()) < 1e-4


def test_placements_on_a_heap_are_truly_at_rest(slab: Slab, state_of: Make, heap: tuple[Box, ...]) -> None:
    model = SimulatorModel()
    for youngs_modulus in (1e4, 3e5, 1e9):
        state = state_of(slab(youngs_modulus=youngs_modulus), heap)
        assert model.predict(state, np.array([[0.02, 0.0]])).warnings == ("",)
        assert model.placement(state).simulation.verify_rest()[0] < 3e-3


def test_a_placement_without_time_to_settle_says_so_and_how_fast_it_still_is(
    slab: Slab, state_of: Make, heap: tuple[Box, ...]
) -> None:
    hurried = SimulatorModel(settings=Settings(longest_time=0.05))
    (warning,) = hurried.predict(state_of(slab(), heap), np.zeros((1, 2))).warnings
    kind, speed, rest = warning.split(" ", 2)
    assert kind == "not_settled:"
    assert float(speed) > 3
    assert rest == "mm/s after 0.06 s"


@pytest.mark.parametrize("level", LEVELS)
def test_every_level_settles_and_agrees_with_the_others(
    level: str, model: SimulatorModel, slab: Slab, state_of: Make, fry: Fry
) -> None:
    boxes = settle_boxes(dinner_plate(), [fry(0, 0, 0.006, 0.4)])
    state = state_of(slab(youngs_modulus=1e5), boxes)
    other = SimulatorModel(settings=LEVELS[level]).predict(state, np.zeros((1, 2)))
    assert other.warnings == ("",)
    assert np.abs(other.heights - model.predict(state, np.zeros((1, 2))).heights).mean() < 4e-4


def test_a_stiff_bone_in_a_soft_item_stays_straight(
    model: SimulatorModel, slab: Slab, state_of: Make, fry: Fry
) -> None:
    boxes = settle_boxes(dinner_plate(), [fry(0.0, 0, 0.006, np.pi / 2)])
    soft = slab(youngs_modulus=1e4)
    materials = soft.materials.copy()
    materials[1, 29:35, 17:47] = 1e9
    sag = [
        np.ptp(model.predict(state_of(item, boxes), np.zeros((1, 2))).heights[0, 31:33, 18:46])
        for item in (soft, replace(soft, materials=materials))
    ]
    assert sag[1] < 0.7 * sag[0]


def test_an_action_off_the_grid_is_the_callers_fault(model: SimulatorModel, slab: Slab, state_of: Make) -> None:
    with pytest.raises(RequestError, match="expected actions on the grid"):
        model.predict(state_of(slab()), np.array([[0.2, 0.0]]))


def test_an_item_larger_than_the_plate_is_the_callers_fault(model: SimulatorModel, slab: Slab, state_of: Make) -> None:
    grid = Grid(128, 128, 0.003)
    with pytest.raises(RequestError, match="expected an item smaller than the plate"):
        model.predict(state_of(slab(110, 110, grid=grid), grid=grid), np.zeros((1, 2)))


def test_boxes_inside_each_other_are_the_callers_fault(
    model: SimulatorModel, slab: Slab, state_of: Make, fry: Fry
) -> None:
    with pytest.raises(RequestError, match="expected boxes that do not overlap"):
        model.predict(state_of(slab(), (fry(0, 0, 0.005), fry(0.002, 0, 0.006, 0.8))), np.zeros((1, 2)))


def test_a_scene_known_only_by_its_heightmap_gives_nearly_the_same_outcome(
    model: SimulatorModel, slab: Slab, state_of: Make, fry: Fry
) -> None:
    boxes = settle_boxes(dinner_plate(), [fry(0.01, 0, 0.006, 0.5)])
    known = state_of(slab(youngs_modulus=1e5), boxes)
    seen = State(replace(known.scene, bodies=None), known.item)
    first, second = (model.predict(state, np.array([[0.0, 0.01]])) for state in (known, seen))
    assert first.warnings == second.warnings == ("",)
    assert np.abs(first.heights - second.heights).mean() < 5e-4


def test_known_boxes_stay_where_they_are_if_only_the_plate_has_to_be_found(
    model: SimulatorModel, slab: Slab, state_of: Make, fry: Fry
) -> None:
    boxes = settle_boxes(dinner_plate(), [fry(0.01, 0, 0.006, 0.5)])
    known = state_of(slab(youngs_modulus=1e9), boxes)
    plateless = State(replace(known.scene, bodies=Bodies(None, boxes)), known.item)
    first, second = (model.predict(state, np.array([[-0.02, 0.01]])) for state in (known, plateless))
    assert np.abs(first.heights - second.heights).mean() < 1e-4


def test_only_the_last_few_states_are_kept(slab: Slab, state_of: Make) -> None:
    model = SimulatorModel()
    states = [state_of(slab(4, 4, thickness=0.01 + 0.001 * i, youngs_modulus=1e9)) for i in range(10)]
    first = model.placement(states[0])
    assert model.placement(states[0]) is first
    for state in states[1:]:
        model.placement(state)
    assert model.placement(states[0]) is not first
