"""How far a cheap model's rewards are from the trusted one's."""

import numpy as np
import pytest

from common.planning.discrepancy import WIDTH, discrepancy

NOWHERE = np.zeros((0, 2))
WANTED = np.array([[0.0, 0.0], [0.02, 0.0], [0.5, 0.5]])


def test_before_anything_was_compared_it_is_zero_give_or_take_the_prior_width():
    mean, deviation = discrepancy(NOWHERE, np.zeros(0), [], WANTED)
    assert mean.tolist() == [0, 0, 0]
    assert deviation.tolist() == [WIDTH] * 3


def test_it_is_known_where_it_was_seen_and_reverts_to_the_mean_far_away():
    mean, deviation = discrepancy(
        np.array([[0.0, 0.0], [0.9, 0.9]]), np.array([-1e-3, 3e-3]), [], np.vstack([WANTED, [[0.9, 0.9]]])
    )
    assert mean[0] == pytest.approx(-1e-3, abs=2e-5)
    assert mean[3] == pytest.approx(3e-3, abs=2e-5)
    assert mean[2] == pytest.approx(1e-3, abs=2e-5)
    assert deviation[0] < deviation[1] < deviation[2]


def test_a_pending_action_lowers_the_uncertainty_and_leaves_the_mean():
    known, differences = np.array([[0.0, 0.0]]), np.array([1e-3])
    mean, deviation = discrepancy(known, differences, [], WANTED)
    pending_mean, pending_deviation = discrepancy(known, differences, [np.array([0.5, 0.5])], WANTED)
    np.testing.assert_allclose(pending_mean, mean, atol=1e-12)
    assert pending_deviation[2] < 0.05 * deviation[2]
