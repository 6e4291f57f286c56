"""The distance to the training data."""

import numpy as np
import torch
from scipy.spatial.distance import mahalanobis as reference

from services.mde.distance import SHRINKAGE, mahalanobis, whitening

POINTS = np.random.default_rng(0).normal(size=(400, 5)) @ np.random.default_rng(1).normal(size=(5, 5)) + 2.0


def test_distances_are_those_of_scipy_with_the_shrunk_covariance():
    mean, whiten = whitening(torch.from_numpy(POINTS).float())
    covariance = np.cov(POINTS.T)
    shrunk = (1 - SHRINKAGE) * covariance + SHRINKAGE * np.trace(covariance) / 5 * np.eye(5)
    expected = [reference(point, POINTS.mean(axis=0), np.linalg.inv(shrunk)) for point in POINTS[:20]]
    found = mahalanobis(torch.from_numpy(POINTS[:20]).float(), mean, whiten).numpy()
    np.testing.assert_allclose(found, expected, rtol=1e-4)


def test_features_that_never_change_do_no_harm():
    points = torch.from_numpy(np.concatenate([POINTS, np.zeros((400, 2))], axis=1)).float()
    mean, whiten = whitening(points)
    near, far = points[:1].clone(), points[:1].clone()
    far[0, -1] = 50.0
    assert mahalanobis(far, mean, whiten) > 3 * mahalanobis(near, mean, whiten)
