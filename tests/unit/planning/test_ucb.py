"""The maximiser."""

import numpy as np
import pytest

from common.planning.ucb import FINEST, is_free, maximise, quasi_random, spread

RADII = (1 / 16, 1 / 64, 1 / 256, 1 / 1024)


@pytest.mark.parametrize("dimensions", [1, 2, 3, 6])
def test_candidates_leave_no_part_of_the_cube_out(dimensions: int):
    candidates = spread(dimensions)
    assert candidates.shape[1] == dimensions
    assert candidates.min() >= 0
    assert candidates.max() <= 1
    corners = np.stack(np.meshgrid(*[[0.25, 0.75]] * dimensions), axis=-1).reshape(-1, dimensions)
    for corner in corners:
        assert (np.abs(candidates - corner) < 0.25).all(axis=1).mean() == pytest.approx(0.5**dimensions, rel=0.35)


@pytest.mark.parametrize(("dimensions", "tolerance"), [(1, 1e-3), (2, 1e-3), (3, 0.02), (6, 0.1)])
def test_a_peak_is_found_from_the_best_candidate(dimensions: int, tolerance: float):
    peak = 0.3 + 0.07 * np.arange(dimensions)

    def bound(points):
        return -np.linalg.norm(points - peak, axis=1)

    candidates = spread(dimensions)
    best = candidates[[int(bound(candidates).argmax())]]
    found = maximise(bound, best, bound(best), radii=RADII, taken=np.empty((0, dimensions)))
    assert np.abs(found - peak).max() < tolerance


def test_a_taken_point_is_not_returned_again():
    peak = np.array([[0.5, 0.5]])
    found = maximise(
        lambda points: -np.linalg.norm(points - peak, axis=1), peak, np.array([-np.inf]), radii=RADII, taken=peak
    )
    assert is_free(found[None], peak).all()
    assert np.abs(found - peak).max() < 4 * FINEST


def test_nothing_outside_the_cube_is_returned():
    corner = np.array([[1.0, 0.0]])
    found = maximise(lambda points: points[:, 0] - points[:, 1], corner, np.array([-np.inf]), radii=RADII, taken=corner)
    assert ((found >= 0) & (found <= 1)).all()


def test_quasi_random_points_are_more_even_than_random_ones():
    points = quasi_random(64, 2)
    counts, _, _ = np.histogram2d(*points.T, bins=4, range=[[0, 1], [0, 1]])
    assert counts.min() >= 3
    assert counts.max() <= 5
