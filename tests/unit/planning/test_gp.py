"""The Gaussian process, against scikit-learn's."""

import numpy as np
import pytest
from sklearn.gaussian_process import GaussianProcessRegressor
from sklearn.gaussian_process.kernels import ConstantKernel, Matern

from common.planning.gp import GaussianProcess

NOISE = 1e-3
SCALES = np.array([[0.1, 0.1], [0.2, 0.4]])
RNG = np.random.default_rng(0)
POINTS, CANDIDATES, ELSEWHERE = RNG.random((20, 2)), RNG.random((30, 2)), RNG.random((7, 2))
REWARDS = -np.hypot(*(POINTS - 0.4).T)


def grown(points, candidates=CANDIDATES):
    process = GaussianProcess(SCALES, noise=NOISE, candidates=candidates)
    for point in points:
        process.append(point)
    return process


def reference(scale, variance, points, rewards):
    kernel = ConstantKernel(variance, "fixed") * Matern(scale, "fixed", nu=2.5)
    return GaussianProcessRegressor(kernel, alpha=variance * NOISE, optimizer=None).fit(points, rewards)


@pytest.mark.parametrize("scale", [0, 1])
def test_mean_deviation_and_likelihood_are_those_of_scikit_learn(scale: int):
    process = grown(POINTS)
    fit = process.fit(REWARDS, mean=-0.3, variance=0.04)
    other = reference(SCALES[scale], 0.04, POINTS, REWARDS + 0.3)
    for asked, points in ((None, CANDIDATES), (ELSEWHERE, ELSEWHERE)):
        mean, deviation = process.predict(fit, asked, scale=scale)
        expected_mean, expected_deviation = other.predict(points, return_std=True)
        np.testing.assert_allclose(mean, expected_mean - 0.3, rtol=1e-9)
        np.testing.assert_allclose(deviation, expected_deviation, rtol=1e-6)
    assert fit.log_likelihood[scale] == pytest.approx(other.log_marginal_likelihood_value_, rel=1e-9)


def test_fitted_mean_and_variance_are_the_most_likely_ones():
    process = grown(POINTS)
    fit = process.fit(REWARDS)
    for scale in (0, 1):
        mean, variance = fit.mean[scale], fit.variance[scale]
        for step in (-0.01, 0.01):
            moved = process.fit(REWARDS, mean=mean + step, variance=variance)
            scaled = process.fit(REWARDS, mean=mean, variance=variance * (1 + step))
            assert moved.log_likelihood[scale] < fit.log_likelihood[scale]
            assert scaled.log_likelihood[scale] < fit.log_likelihood[scale]


@pytest.mark.parametrize("scale", [0, 1])
def test_a_pending_point_lowers_the_deviation_as_if_told_and_leaves_the_mean(scale: int):
    pending = grown(POINTS)
    fit = pending.fit(REWARDS[:12], mean=-0.3, variance=0.04)
    mean, deviation = pending.predict(fit, scale=scale)
    told = reference(SCALES[scale], 0.04, POINTS[:12], REWARDS[:12] + 0.3)
    all_told = reference(SCALES[scale], 0.04, POINTS, np.zeros(20))
    np.testing.assert_allclose(mean, told.predict(CANDIDATES) - 0.3, rtol=1e-9)
    np.testing.assert_allclose(deviation, all_told.predict(CANDIDATES, return_std=True)[1], rtol=1e-6)


def test_forgotten_points_leave_no_trace():
    process = grown(np.vstack([POINTS[:9], ELSEWHERE]))
    process.truncate(9)
    for point in POINTS[9:]:
        process.append(point)
    fresh = grown(POINTS)
    for values, expected in zip(
        process.predict(process.fit(REWARDS), scale=0), fresh.predict(fresh.fit(REWARDS), scale=0), strict=True
    ):
        np.testing.assert_allclose(values, expected, rtol=1e-9)


def test_equal_rewards_still_leave_most_uncertainty_far_away():
    process = grown(POINTS[:3], candidates=np.array([POINTS[0], POINTS[0] + 0.4]))
    mean, deviation = process.predict(process.fit(np.full(3, -0.02)), scale=0)
    np.testing.assert_allclose(mean, -0.02)
    assert 0 < deviation[0] < deviation[1]
