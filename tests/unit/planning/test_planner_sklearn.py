"""The planner with scikit-learn's regressor, by itself and as a strategy."""

import numpy as np
import pytest

from common.domain.errors import RequestError
from common.planning.planner import Planner
from common.planning.planner_sklearn import SklearnPlanner
from common.planning.selection import parse_strategy

SQUARE = np.array([[-0.08, 0.08], [-0.08, 0.08]])
PEAK = np.array([0.031, -0.052])


def play(planner: Planner, evaluations: int) -> list[np.ndarray]:
    asked = []
    for _ in range(evaluations):
        index, action = planner.ask()
        asked.append(action)
        planner.tell(index, -float(np.linalg.norm(action - PEAK)))
    return asked


def test_it_begins_like_our_own_planner_and_finds_the_peak_of_a_cone():
    ours, theirs = play(Planner(SQUARE, seed=1), 6), play(planner := SklearnPlanner(SQUARE, seed=1), 25)
    np.testing.assert_array_equal(ours, theirs[:6])
    assert planner.incumbent is not None
    assert np.linalg.norm(planner.incumbent.action - PEAK) < 2e-3


def test_pending_and_failed_actions_are_not_asked_again():
    planner = SklearnPlanner(SQUARE, seed=1)
    play(planner, 8)
    failed, _ = planner.ask()
    planner.tell(failed, None)
    asked = np.array([planner.ask()[1] for _ in range(3)])
    assert (np.linalg.norm(asked[:, None] - asked, axis=2) + np.eye(3)).min() > 1e-3


def test_any_strategy_that_leaves_the_actions_to_gp_ucb_can_have_it():
    for name in ("threshold", "threshold:upper", "only:heuristic", "random"):
        chosen = parse_strategy(f"{name}@scikit-learn")
        assert chosen.name == f"{name}@scikit-learn"
        assert chosen.required("simulator") == parse_strategy(name).required("simulator")


@pytest.mark.parametrize("name", ["quality@scikit-learn", "threshold@numpy", "threshold@", "threshold@scikit-learn@x"])
def test_another_planner_or_a_strategy_with_a_plan_of_its_own_is_refused(name: str):
    with pytest.raises(RequestError, match="strategy: expected"):
        parse_strategy(name)


def test_without_scikit_learn_an_error_says_what_to_install(monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setattr("common.planning.planner_sklearn.find_spec", lambda name: None)
    with pytest.raises(RequestError, match="pip install"):
        SklearnPlanner(SQUARE, seed=0)
