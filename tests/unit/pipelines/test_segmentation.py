"""Telling food from plate by its height."""

import numpy as np

from common.domain.grid import Grid
from pipelines.data.segmentation import HeightSegmenter

GRID = Grid()
X, Y = GRID.x[None, :], GRID.y[:, None]


def fry(x, y):
    return np.where((np.abs(X - x) < 0.03) & (np.abs(Y - y) < 0.005), 0.010, 0.0)


def test_two_fries_apart_are_two_pieces_that_cover_them():
    rise = fry(0.0, 0.03) + fry(0.01, -0.03)
    pieces = HeightSegmenter().segment(rise, GRID)
    assert ((pieces > 0) == (rise > 0)).mean() > 0.999
    assert not set(pieces[Y[:, 0] > 0].ravel()) & set(pieces[Y[:, 0] < 0].ravel()) - {0}


def test_a_plate_with_noise_has_no_pieces():
    noise = np.random.default_rng(0).normal(0, 5e-4, GRID.shape)
    assert HeightSegmenter().segment(noise, GRID).max() == 0


def test_a_ring_at_the_rim_is_no_food_but_a_steak_that_hangs_over_it_is():
    radius = np.hypot(X, Y)
    ring = np.where((radius > 0.119) & (radius < 0.123), 0.012, 0.0)
    assert HeightSegmenter().segment(ring, GRID).max() == 0
    steak = np.where(np.hypot(X - 0.10, Y) < 0.035, 0.02, 0.0)
    found = HeightSegmenter().segment(np.maximum(ring, steak), GRID) > 0
    assert (found & (steak > 0)).sum() > 0.95 * (steak > 0).sum()


def test_a_hole_in_a_piece_is_filled():
    rise = np.where(np.hypot(X, Y) < 0.03, 0.02, 0.0)
    rise[48, 48] = 0.0
    assert HeightSegmenter().segment(rise, GRID)[48, 48] > 0
