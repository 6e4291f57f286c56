"""Figures of estimates, against independent implementations."""

import numpy as np
import pytest
from scipy.stats import rankdata, spearmanr
from sklearn.metrics import roc_auc_score

from pipelines.mde.scores import acceptance, auroc, coverage, mean_absolute_error, ranks, spearman

RNG = np.random.default_rng(0)
TRUTH = RNG.uniform(0, 1, 200)
ESTIMATES = np.round(np.clip(TRUTH + RNG.normal(0, 0.2, 200), 0, 1), 2)


def test_ranks_share_their_mean_where_values_are_equal():
    np.testing.assert_array_equal(ranks(ESTIMATES), rankdata(ESTIMATES))


def test_the_area_under_the_curve_is_that_of_scikit_learn():
    assert auroc(TRUTH < 0.4, -ESTIMATES) == pytest.approx(roc_auc_score(TRUTH < 0.4, -ESTIMATES))
    assert auroc(TRUTH < 2.0, -ESTIMATES) is None


def test_the_rank_correlation_is_that_of_scipy():
    assert spearman(TRUTH, ESTIMATES) == pytest.approx(spearmanr(TRUTH, ESTIMATES)[0])
    assert spearman(TRUTH, np.ones(200)) is None


def test_acceptance_counts_what_it_says():
    truth, estimates = np.array([0.1, 0.2, 0.5, 0.6, 0.7]), np.array([0.3, 0.5, 0.1, 0.6, 0.9])
    found = acceptance(truth, estimates, d_max=0.4)
    assert found.within == pytest.approx(2 / 5)
    assert found.recall == pytest.approx(1 / 2)
    assert found.false_accept_rate == pytest.approx(1 / 3)
    assert found.bad_share == pytest.approx(1 / 2)
    assert found.accepted == pytest.approx(2 / 5)
    nothing = acceptance(truth, estimates, d_max=0.05)
    assert (nothing.recall, nothing.bad_share, nothing.auroc) == (None, None, None)


def test_errors_and_coverage_are_means():
    assert mean_absolute_error(np.array([0.1, 0.5]), np.array([0.2, 0.2])) == pytest.approx(0.2)
    assert coverage(np.array([0.1, 0.5, 0.3]), np.array([0.1, 0.4, 0.6])) == pytest.approx(2 / 3)
