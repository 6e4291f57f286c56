"""Ask and tell."""

from collections import deque

import numpy as np
import pytest

from common.domain.errors import RequestError
from common.planning import planner as planner_module
from common.planning.planner import Planner

SQUARE = np.array([[-0.08, 0.08], [-0.08, 0.08]])


def cone(peak):
    return lambda action: -float(np.linalg.norm(action - np.asarray(peak)))


def play(planner: Planner, reward, *, evaluations: int, in_flight: int = 1, failed: frozenset[int] = frozenset()):
    """Return the asked actions ``(evaluations, n)``, told in the order of asking."""
    actions, pending = [], deque()
    for _ in range(evaluations):
        if len(pending) == in_flight:
            planner.tell(*pending.popleft())
        index, action = planner.ask()
        actions.append(action)
        pending.append((index, None if index in failed else reward(action)))
    for answer in pending:
        planner.tell(*answer)
    return np.array(actions)


@pytest.mark.parametrize("in_flight", [1, 4])
@pytest.mark.parametrize("peak", [(0.031, -0.052), (-0.0771, 0.0612), (0.0, 0.0)])
def test_fifty_evaluations_find_the_peak_of_a_cone_within_half_a_millimetre(peak, in_flight: int):
    planner = Planner(SQUARE, seed=1)
    play(planner, cone(peak), evaluations=50, in_flight=in_flight)
    assert planner.incumbent is not None
    assert np.linalg.norm(planner.incumbent.action - peak) < 5e-4


@pytest.mark.parametrize(("dimensions", "evaluations", "tolerance"), [(1, 20, 0.005), (3, 50, 0.06), (6, 70, 0.5)])
def test_a_peak_is_found_in_other_dimensions_too(dimensions: int, evaluations: int, tolerance: float):
    bounds = np.repeat([[-1.0, 1.0]], dimensions, axis=0)
    planner = Planner(bounds, seed=0)
    peak = np.linspace(-0.5, 0.4, dimensions)
    actions = play(planner, cone(peak), evaluations=evaluations)
    assert (np.abs(actions) <= 1).all()
    assert planner.incumbent is not None
    assert np.linalg.norm(planner.incumbent.action - peak) < tolerance


@pytest.mark.parametrize("in_flight", [1, 3])
def test_the_same_seed_asks_the_same_actions_to_the_bit(in_flight: int):
    first, second = (
        play(Planner(SQUARE, seed=7), cone((0.02, 0.03)), evaluations=20, in_flight=in_flight) for _ in range(2)
    )
    np.testing.assert_array_equal(first, second)


def test_another_seed_begins_elsewhere():
    _, first = Planner(SQUARE, seed=1).ask()
    _, other = Planner(SQUARE, seed=2).ask()
    assert np.abs(first - other).max() > 1e-3


@pytest.mark.parametrize("in_flight", [1, 4])
def test_no_action_is_asked_twice(in_flight: int):
    actions = play(Planner(SQUARE, seed=3), cone((0.02, 0.03)), evaluations=60, in_flight=in_flight)
    distances = np.abs(actions[:, None] - actions[None]).max(axis=2) + np.eye(60)
    assert distances.min() > 3e-5


def test_many_actions_can_be_asked_before_any_is_told():
    planner = Planner(SQUARE, seed=0)
    actions = np.array([planner.ask()[1] for _ in range(16)])
    assert (np.linalg.norm(actions[:, None] - actions[None], axis=2) + np.eye(16)).min() > 0.01


def test_the_order_of_telling_decides_nothing_but_what_is_known_when_asking():
    planners = [Planner(SQUARE, seed=5), Planner(SQUARE, seed=5)]
    reward = cone((0.01, 0.02))
    for planner, order in zip(planners, [(0, 1, 2, 3, 4, 5, 6, 7), (7, 3, 1, 0, 2, 6, 5, 4)], strict=True):
        asked = dict(planner.ask() for _ in range(8))
        for index in order:
            planner.tell(index, reward(asked[index]))
    (_, first), (_, second) = (planner.ask() for planner in planners)
    np.testing.assert_allclose(first, second, atol=1e-6)


def test_a_failed_action_is_not_asked_again_and_the_others_still_lead_to_the_peak():
    planner = Planner(SQUARE, seed=1)
    actions = play(planner, cone((0.03, -0.05)), evaluations=40, in_flight=2, failed=frozenset({2, 9, 10, 20}))
    distances = np.abs(actions[:, None] - actions[None]).max(axis=2) + np.eye(40)
    assert distances.min() > 3e-5
    assert planner.incumbent is not None
    assert np.linalg.norm(planner.incumbent.action - (0.03, -0.05)) < 1e-3


def test_the_incumbent_is_the_earliest_of_the_best():
    planner = Planner(SQUARE, seed=0)
    assert planner.incumbent is None
    asked = [planner.ask() for _ in range(4)]
    for index, reward in enumerate([-0.3, -0.1, None, -0.1]):
        planner.tell(index, reward)
    assert planner.incumbent is not None
    assert planner.incumbent.index == 1
    assert planner.incumbent.reward == -0.1
    np.testing.assert_array_equal(planner.incumbent.action, asked[1][1])


def test_equal_rewards_everywhere_still_explore():
    actions = play(Planner(SQUARE, seed=0), lambda action: -0.01, evaluations=24)
    assert np.ptp(actions, axis=0).min() > 0.14


def test_long_runs_leave_rewards_out_and_keep_the_best(monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setattr(planner_module, "LARGEST", 24)
    planner = Planner(SQUARE, seed=1)
    play(planner, cone((0.03, -0.05)), evaluations=90, in_flight=2)
    assert planner.incumbent is not None
    assert np.linalg.norm(planner.incumbent.action - (0.03, -0.05)) < 5e-4


@pytest.mark.parametrize(
    ("bounds", "complaint"),
    [
        ([[0.0, 0.0], [0, 1]], "smallest value below its largest"),
        ([[1.0, -1.0]], "smallest value below its largest"),
        ([[0.0, np.inf]], "finite"),
        ([0.0, 1.0], "shape"),
        (np.zeros((7, 2)), "n from 1 to 6"),
        (np.zeros((0, 2)), "n from 1 to 6"),
    ],
)
def test_impossible_bounds_are_refused(bounds, complaint: str):
    with pytest.raises(RequestError, match=complaint):
        Planner(np.array(bounds), seed=0)


@pytest.mark.parametrize(("index", "reward"), [(1, -1.0), (-1, -1.0), (0, float("nan")), (0, float("inf"))])
def test_what_was_not_asked_or_is_not_finite_cannot_be_told(index: int, reward: float):
    planner = Planner(SQUARE, seed=0)
    planner.ask()
    with pytest.raises(RequestError, match="tell: expected"):
        planner.tell(index, reward)


@pytest.mark.parametrize("reward", [-1.0, None])
def test_nothing_is_told_twice(reward: float | None):
    planner = Planner(SQUARE, seed=0)
    planner.ask()
    planner.tell(0, reward)
    with pytest.raises(RequestError, match="expected a pending trial, got 0"):
        planner.tell(0, -1.0)
