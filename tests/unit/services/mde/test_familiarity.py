"""Which states are like those of the training data."""

from dataclasses import replace

import numpy as np
import pytest

from common.domain.bodies import Bodies, Plate
from common.domain.grid import Grid
from common.domain.scene import Item, Scene, State
from common.tasks.plating import dinner_plate, render_scene
from common.tasks.plating_sampler import sample_item, sample_scene
from services.mde.familiarity import Familiarity

GRID = Grid(64, 64, 0.0045)


def draw(seed: int) -> State:
    rng = np.random.default_rng(seed)
    scene = sample_scene(rng, GRID, settle=lambda plate, boxes: tuple(boxes))
    return State(scene, sample_item(rng, GRID))


STATES = [draw(seed) for seed in range(80)]


@pytest.fixture(scope="module")
def known() -> Familiarity:
    return Familiarity.of(
        GRID,
        *(
            np.stack(arrays)
            for arrays in zip(
                *((s.scene.heights, s.scene.materials, s.item.heights, s.item.materials) for s in STATES), strict=True
            )
        ),
        actions=np.array([[0.05, 0.0], [-0.03, 0.04], [0.01, -0.06]]),
    )


def with_modulus(state: State, modulus: float) -> State:
    materials = state.item.materials.copy()
    materials[1][materials[1] > 0] = modulus
    return State(state.scene, Item(state.item.heights, materials))


def on_plate(state: State, plate: Plate) -> State:
    bodies = state.scene.bodies
    assert bodies is not None
    return State(render_scene(GRID, Bodies(plate, bodies.boxes)), state.item)


def test_every_state_that_it_learned_from_is_familiar(known: Familiarity):
    assert [known.complaint(state) for state in STATES] == [""] * len(STATES)


def test_most_new_states_of_the_same_kind_are_familiar(known: Familiarity):
    complaints = [known.complaint(draw(seed)) for seed in range(200, 240)]
    assert sum(not complaint for complaint in complaints) >= 28, complaints


def test_another_grid_is_named(known: Familiarity):
    grid = Grid(64, 64, 0.004)
    state = State(replace(STATES[0].scene, grid=grid), STATES[0].item)
    assert known.complaint(state).startswith("grid: expected Grid(rows=64, columns=64, cell=0.0045), got")


@pytest.mark.parametrize("modulus", [1e2, 1e7, 1e11])
def test_a_stiffness_that_was_never_seen_is_named(known: Familiarity, modulus: float):
    assert "log10 of Young's modulus" in known.complaint(with_modulus(STATES[0], modulus))


def plates() -> dict[str, Plate]:
    plate = dinner_plate()
    return {
        "raised": Plate(plate.radii, plate.heights + 0.01),
        "smaller": Plate(0.8 * plate.radii, plate.heights),
        "flat": Plate(plate.radii, np.minimum(plate.heights, 0.0)),
        "with a steeper rim": Plate(plate.radii, np.where(plate.heights > 0, 1.6 * plate.heights, plate.heights)),
    }


@pytest.mark.parametrize("name", plates())
def test_another_plate_is_named(known: Familiarity, name: str):
    assert known.complaint(on_plate(STATES[0], plates()[name])).startswith("plate: expected")


def test_the_noise_of_a_depth_camera_is_no_other_plate(known: Familiarity):
    scene = STATES[0].scene
    noise = np.random.default_rng(0).normal(0, 5e-4, GRID.shape).astype(np.float32)
    assert known.complaint(State(replace(scene, heights=scene.heights + noise), STATES[0].item)) == ""


def test_an_item_thicker_than_all_others_is_named(known: Familiarity):
    item = STATES[0].item
    assert "item's thickness" in known.complaint(State(STATES[0].scene, Item(3 * item.heights, item.materials)))


def test_a_scene_without_fries_is_named_by_its_area(known: Familiarity):
    empty = Scene(GRID, dinner_plate().heightmap(GRID), np.zeros((3, *GRID.shape), np.float32))
    assert "fries' area" in known.complaint(State(empty, STATES[0].item))


def test_actions_further_out_than_all_others_are_not_covered(known: Familiarity):
    actions = np.array([[0.0, 0.0], [0.04, 0.04], [0.0, 0.062], [0.0, 0.07], [-0.05, 0.05]])
    assert known.reaches(actions).tolist() == [True, True, True, False, False]


def test_it_survives_a_card(known: Familiarity):
    again = Familiarity.from_statistics(GRID, known.statistics())
    assert again == known
    with pytest.raises(ValueError, match="rings"):
        Familiarity.from_statistics(Grid(32, 32, 0.009), {**known.statistics(), "plate": [0.0]})
