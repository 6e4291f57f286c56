"""What an optimisation can say about what it may have missed."""

import math

import numpy as np
import pytest

from common.planning.certificate import (
    FACTORS,
    PROBABILITY,
    SMALLEST,
    certified_grid,
    certify,
    conformal_quantile,
    correction,
    needed_factor,
    slack,
)
from common.planning.places import Places, Swept
from common.planning.space import Space

ACTIONS = np.array([[0.0, 0.0], [0.01, 0.0], [0.0, 0.02]])
SWEPT = Swept("heuristic", ACTIONS, np.zeros(3), ACTIONS[:0], np.zeros(0))
PLACES = Places(ACTIONS, np.array([-3e-3, -1e-3, -2e-3]), np.ones(3), None, "heuristic", SWEPT)


def test_a_model_that_deviates_as_expected_needs_no_correction():
    assert correction([(1e-3, 1e-3), (2e-3, 2e-3)], 5e-4) == pytest.approx(1)
    assert correction([], 5e-4) == 1
    assert correction([], 0.0) == 1


def test_deviations_beyond_the_estimates_widen_the_bounds_the_more_were_seen():
    once, often = correction([(1e-3, 2e-3)], 1e-3), correction([(1e-3, 2e-3)] * 9, 1e-3)
    assert once == pytest.approx(1.5)
    assert often == pytest.approx(1.9)


def test_the_slack_is_what_the_highest_bound_leaves_possible():
    possible, left = slack(PLACES, np.array([0.2e-3, 0.5e-3, 1.9e-3]), -0.4e-3)
    assert possible == pytest.approx(0.3e-3)
    assert left == pytest.approx(1 / 3)
    possible, left = slack(PLACES, np.zeros(3), -0.4e-3)
    assert possible == pytest.approx(-0.6e-3)
    assert left == 0


@pytest.mark.parametrize(("possible", "calls"), [(3e-4, 1), (3e-4, 12), (-2e-4, 5)])
def test_a_certificate_with_the_needed_factor_just_holds(possible: float, calls: int, monkeypatch: pytest.MonkeyPatch):
    gain = 7e-5
    factor = needed_factor(gain, possible, calls)
    for stretch, holds in ((1.001, True), (0.999, False)):
        monkeypatch.setattr("common.planning.certificate.FACTORS", {"heuristic": stretch * factor})
        found = certify("heuristic", possible, 0.5, calls=calls, actions=113)
        assert found is not None
        assert (gain <= found.gain) is holds
        assert (found.probability, found.actions, found.left) == (PROBABILITY, 113, 0.5)


def test_bounds_that_leave_nothing_possible_leave_almost_no_gain():
    found = certify("heuristic", -1e-3, 0.0, calls=4, actions=113)
    assert found is not None
    assert found.gain == pytest.approx(FACTORS["heuristic"] * SMALLEST / 4)


def test_there_is_no_certificate_for_a_model_whose_factor_nobody_measured():
    assert certify("crystal ball", 1e-4, 0.5, calls=3, actions=113) is None


def test_the_conformal_quantile_covers_the_next_score_with_the_stated_probability():
    rng = np.random.default_rng(0)
    covered = []
    for _ in range(4000):
        scores = rng.exponential(size=25)  # the last one is the next target's
        covered.append(scores[-1] <= conformal_quantile(scores[:-1].tolist(), 0.8))
    exact = math.ceil(25 * 0.8) / 25
    assert np.mean(covered) == pytest.approx(exact, abs=4 * math.sqrt(exact * (1 - exact) / len(covered)))


def test_too_few_targets_support_no_statement():
    assert conformal_quantile([1.0] * 8, 0.9) == math.inf
    assert conformal_quantile([1.0] * 9, 0.9) == 1.0


def test_the_grid_holds_the_places_and_the_answer_s_neighbours_within_the_limits():
    limits, unit = np.array([[-0.08, 0.08], [-0.08, 0.08]]), np.full(2, 2.5e-4)
    answer = np.array([0.0798, 0.03])
    grid = certified_grid(PLACES, answer, unit, Space(limits, np.zeros(2, dtype=bool)))
    assert len(np.unique(grid, axis=0)) == len(grid)
    neighbours = answer + np.array([[0.0, 0.0], [-1e-3, 1e-3], [-3e-3, -3e-3]])
    for action in (*ACTIONS, *neighbours):
        assert np.abs(grid - action).max(axis=1).min() < 1e-12
    assert (np.abs(grid) <= 0.08).all()
