import hashlib
import json
from pathlib import Path

import numpy as np
import pytest

from common.storage.cases import read_cases
from common.tasks import TASKS
from common.tasks.plating import Plating
from pipelines.cases import BUNDLED, BUNDLED_YAW

FOLDER = Path(__file__).parents[3] / "examples" / "scenes"
FOLDER_YAW = FOLDER.with_name("scenes_yaw")
REFRESH = "run `python -m pipelines.cases` and commit the result"


@pytest.fixture(scope="module")
def cases():
    return read_cases(FOLDER)


def test_every_recipe_has_its_scene_and_every_scene_its_recipe(cases):
    assert [case.name for case in cases] == sorted(recipe.name for recipe in BUNDLED), REFRESH
    assert {case.name: case.seed for case in cases} == {recipe.name: recipe.seed for recipe in BUNDLED}, REFRESH


def test_files_are_those_of_the_card_and_small():
    card = json.loads((FOLDER / "card.json").read_text())["cases"]
    for name, entry in card.items():
        content = (FOLDER / f"{name}.npz").read_bytes()
        assert hashlib.sha256(content).hexdigest() == entry["sha256"], REFRESH
        assert len(content) < 100_000


def test_scenes_have_settled_fries_on_the_plate_and_a_true_action_within_bounds(cases):
    for case in cases:
        boxes = case.state.scene.bodies.boxes
        assert 4 <= len(boxes) <= 12
        assert all(np.hypot(*box.position[:2]) < 0.12 for box in boxes)
        low, high = Plating().bounds(case.state).T
        assert (case.true_action >= low).all()
        assert (case.true_action <= high).all()


def test_soft_and_rigid_items_and_targets_of_other_items_are_there(cases):
    same = [case for case in cases if case.same_item]
    assert len(same) >= 4
    assert len(cases) - len(same) >= 2
    assert {case.state.item.is_rigid for case in same} == {True, False}


def test_turned_scenes_are_those_of_their_recipes_and_need_a_turn():
    cases = read_cases(FOLDER_YAW)
    card = json.loads((FOLDER_YAW / "card.json").read_text())["cases"]
    assert [case.name for case in cases] == [recipe.name for recipe in BUNDLED_YAW], f"{REFRESH}, with --yaw"
    for case in cases:
        content = (FOLDER_YAW / f"{case.name}.npz").read_bytes()
        assert hashlib.sha256(content).hexdigest() == card[case.name]["sha256"]
        assert case.task == "plating_yaw"
        low, high = TASKS[case.task].bounds(case.state).T
        assert (case.true_action >= low).all()
        assert (case.true_action <= high).all()
        assert abs(case.true_action[2]) > 0.2
