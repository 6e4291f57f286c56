"""The calibrated upper bound."""

import numpy as np
import pytest

from services.mde.calibration import conformal_factor


@pytest.mark.parametrize("coverage", [0.5, 0.8, 0.9, 0.95])
def test_the_bound_holds_for_the_stated_share_of_new_samples(coverage: float):
    rng = np.random.default_rng(0)
    scale = rng.uniform(0.2, 2.0, 40_000)
    median, truth = np.zeros(40_000), scale * rng.gumbel(size=40_000)
    held = []
    for start in range(0, 40_000, 2000):
        seen, new = np.s_[start : start + 500], np.s_[start + 500 : start + 2000]
        factor = conformal_factor(truth[seen], median[seen], scale[seen], coverage=coverage)
        held.append((truth[new] <= median[new] + factor * scale[new]).mean())
    assert np.mean(held) == pytest.approx(coverage, abs=0.01)


def test_the_factor_is_the_order_statistic_of_the_definition():
    scores = np.random.default_rng(1).normal(size=99)
    # ceil(100 * 0.9) = 90th smallest
    assert conformal_factor(scores, np.zeros(99), np.ones(99), coverage=0.9) == np.sort(scores)[89]


def test_too_few_samples_give_the_largest_score():
    assert conformal_factor(np.array([0.1, 0.7, 0.3]), np.zeros(3), np.ones(3), coverage=0.9) == 0.7
