import json

import numpy as np
import pytest

from common.domain.deviation import deviation
from common.domain.errors import ModelError
from common.domain.grid import Grid
from common.storage.cases import read_case
from common.tasks import TASKS
from pipelines.cases import ATTEMPTS, BUNDLED, CaseRecipe, make_case, make_cases, random_recipes
from services.heuristic import HeuristicModel

SAME = CaseRecipe("same", 1, "scattered", "medallion", False, "bare")
OTHER = CaseRecipe("other", 2, "heap", "steak", True, same_item=False)


def as_drawn(plate, boxes):
    return tuple(boxes)


class Restless(HeuristicModel):
    """Comes to rest only from the third call on."""

    def __init__(self, restless_calls=2):
        self.calls, self.restless_calls = 0, restless_calls

    def outcomes(self, state, actions):
        self.calls += 1
        heights, warnings = super().outcomes(state, actions)
        return heights, ("not_settled: 5 mm/s",) * len(warnings) if self.calls <= self.restless_calls else warnings


def make(recipe, model=None):
    return make_case(recipe, settle=as_drawn, model=model or HeuristicModel(), grid=Grid())


def test_the_true_action_reaches_a_target_of_the_same_item_exactly():
    case = make(SAME)
    outcome = HeuristicModel().predict(case.state, np.array([case.true_action])).heights[0]
    assert (outcome == case.target).all()
    assert case.reference_action == case.true_action


def test_a_target_of_another_item_is_not_reached_and_its_action_is_recorded():
    case = make(OTHER)
    outcome = HeuristicModel().predict(case.state, np.array([case.true_action])).heights[0]
    assert deviation(outcome, case.target) > 1e-5
    assert case.reference_action is None


def test_a_recipe_makes_the_same_case_twice():
    assert make(SAME).state.digest == make(SAME).state.digest
    assert make(SAME).true_action == make(SAME).true_action


def test_a_target_that_is_not_at_rest_is_drawn_again():
    model = Restless()
    case = make(SAME, model)
    assert model.calls == 3
    assert case.state.digest != make(SAME).state.digest


def test_a_model_that_never_rests_ends_in_an_error():
    with pytest.raises(ModelError, match=f"same: expected a target at rest within {ATTEMPTS} draws.*not_settled"):
        make(SAME, Restless(1000))


def test_cases_are_made_once_and_again_only_if_recipe_model_or_file_changed(tmp_path):
    def run(recipes, version="1"):
        model = HeuristicModel()
        model.version = version
        return make_cases(recipes, tmp_path, settle=as_drawn, model=model, grid=Grid())

    assert run([SAME, OTHER]) == 2
    assert run([SAME, OTHER]) == 0
    assert run([SAME, OTHER], version="2") == 2
    assert run([CaseRecipe("same", 5, "scattered"), OTHER], version="2") == 1
    (tmp_path / "other.npz").write_bytes(b"broken")
    assert run([CaseRecipe("same", 5, "scattered"), OTHER], version="2") == 1
    card = json.loads((tmp_path / "card.json").read_text())["cases"]
    assert card["same"]["settings"]["seed"] == read_case(tmp_path / "same.npz").seed == 5


def test_half_of_the_random_recipes_are_of_another_item_and_all_seeds_differ():
    recipes = random_recipes(10, 3) + random_recipes(10, 4)
    assert sum(recipe.same_item for recipe in recipes) == 10
    assert len({recipe.seed for recipe in recipes}) == 20


def test_the_bundled_recipes_cover_soft_and_rigid_items_and_every_place():
    same = [recipe for recipe in BUNDLED if recipe.same_item]
    assert len(same) >= 4
    assert len(BUNDLED) - len(same) >= 2
    assert {recipe.rigid for recipe in same} >= {True, False}
    assert {recipe.place for recipe in BUNDLED} == {"heap_edge", "rim", "bare", "anywhere"}
    assert len({recipe.name for recipe in BUNDLED}) == len({recipe.seed for recipe in BUNDLED}) == len(BUNDLED)


def test_a_turned_target_is_the_outcome_of_its_three_parameters():
    case = make(CaseRecipe("turned", 3, "heap", "irregular", False, "heap_edge", yaw=True))
    model = TASKS[case.task].adapt_model(HeuristicModel())
    assert len(case.true_action) == 3
    assert (model.predict(case.state, np.array([case.true_action])).heights[0] == case.target).all()
