"""Where to begin."""

from dataclasses import dataclass, field

import numpy as np
import pytest
from numpy.typing import NDArray
from planning_fakes import TRUE_ACTION, FakeEstimator, FakeModel, small_problem

from common.domain.errors import ModelError
from common.domain.grid import Floats
from common.domain.scene import State
from common.planning.places import MOST_PLACES, around, best_apart, find_places
from common.planning.plan import Setting
from common.planning.space import Space
from common.planning.sweep import Sweeps
from services.heuristic import HeuristicModel

PROBLEM = small_problem()


@dataclass
class Noting(FakeModel):
    """Keeps what it was asked about."""

    asked: list[NDArray[np.float64]] = field(default_factory=list)

    def outcomes(self, state: State, actions: NDArray[np.float64]) -> tuple[Floats, tuple[str, ...]]:
        self.asked.append(actions)
        return super().outcomes(state, actions)


SPACE = Space.of(PROBLEM)


def setting(*models, estimators=()) -> Setting:
    named = {model.name: model for model in models} | {"simulator": FakeModel()}
    sweeps = Sweeps(
        PROBLEM,
        named,
        {estimator.model: estimator for estimator in estimators},
        now=lambda: 0.0,
        wait_for=lambda question: question(),
    )
    return Setting(PROBLEM, tuple(named), "simulator", 12, 0, sweeps)


def test_the_cheapest_model_s_best_place_is_near_the_true_action():
    places = find_places(setting(HeuristicModel()), models=1)
    assert places.model == "heuristic"
    assert len(places.actions) <= MOST_PLACES
    best = places.actions[int(places.rewards.argmax())]
    assert np.linalg.norm(best - TRUE_ACTION) < 2.5e-3
    assert (places.widths == 1).all()


def test_a_dearer_model_is_asked_some_dozen_times_where_the_cheapest_points():
    learned = FakeModel(name="learned")
    asked = setting(HeuristicModel(), learned)
    places = find_places(asked, models=2)
    assert places.model == "learned"
    survey = asked.survey
    assert isinstance(survey, Sweeps)
    assert 12 <= survey.usage["learned"] <= 31


def test_a_dearer_model_is_not_asked_twice_about_one_place():
    learned = Noting(name="learned")
    find_places(setting(HeuristicModel(), learned), models=2)
    asked = np.concatenate(learned.asked)
    gaps = np.linalg.norm(asked[:, None] - asked[None], axis=2) + np.eye(len(asked))
    assert len(asked) >= 12
    assert gaps.min() > 1e-3


def test_a_dearer_model_that_fails_leaves_the_cheaper_one_s_word():
    places = find_places(setting(HeuristicModel(), FakeModel(name="learned", error=ModelError("bad"))), models=2)
    assert places.model == "heuristic"


@pytest.mark.parametrize("models", [1, 2])
def test_where_the_cheapest_fails_the_next_one_is_asked(models: int):
    broken = FakeModel(name="heuristic", error=ModelError("bad"))
    assert find_places(setting(broken, FakeModel(name="learned")), models=models).model == "learned"


def test_without_a_cheap_model_the_places_cover_the_bounds():
    places = find_places(setting(), models=3)
    assert places.model == ""
    assert (places.rewards == 0).all()
    assert np.ptp(places.actions, axis=0).min() > 0.7 * np.ptp(PROBLEM.limits, axis=1).min()


def test_an_mde_widens_what_it_doubts():
    doubtful = FakeEstimator(mean=lambda x: 0.6 if x > TRUE_ACTION[0] else 0.2)
    places = find_places(setting(HeuristicModel(), estimators=[doubtful]), models=1)
    right = places.actions[:, 0] > TRUE_ACTION[0]
    assert places.widths[right].min() == pytest.approx(3 * places.widths[~right].max())
    assert places.widths.mean() == pytest.approx(1)


def test_the_best_that_are_apart_are_the_best_of_their_neighbourhoods():
    actions = np.array([[0.0, 0.0], [0.001, 0.0], [0.05, 0.0], [0.05, 0.05]])
    rewards = np.array([1.0, 2.0, 0.5, 3.0])
    assert best_apart(actions, rewards, 3, np.array([0.01, 0.01]), SPACE).tolist() == [3, 1, 2]


def test_a_grid_around_a_centre_stays_within_the_limits():
    space = Space(np.array([[-0.08, 0.08], [-0.08, 0.08]]), np.zeros(2, dtype=bool))
    near = around(np.array([[0.079, 0.0]]), np.array([0.002, 0.002]), side=5, space=space)
    assert near[:, 0].max() == 0.08
    assert near[:, 1].min() == pytest.approx(-0.004)
