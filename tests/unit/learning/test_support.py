"""Where an unbending item rests, against a general solver of linear programmes and by hand."""

import numpy as np
import pytest
from scipy.optimize import linprog

from common.learning.support import resting_plane

ROWS, COLUMNS = np.mgrid[:24, :30].astype(float)
DISC = np.hypot(COLUMNS - 14, ROWS - 11) < 8
ONES = np.ones(DISC.shape)


def resting_gap(scene: np.ndarray, outline: np.ndarray, weight: np.ndarray) -> np.ndarray:
    """Return the gap between the scene and the bottom of an item at rest on it, 0 beside the item."""
    slope_x, slope_y, offset = resting_plane(scene, outline, weight)
    return np.where(outline, slope_x * COLUMNS + slope_y * ROWS + offset - scene, 0)


def height_at_centre(scene: np.ndarray, outline: np.ndarray, weight: np.ndarray) -> float:
    """Return the lowest height of a plane over the scene at the item's centre of mass."""
    x, y, mass = COLUMNS[outline], ROWS[outline], weight[outline]
    centre = [(mass * x).sum() / mass.sum(), (mass * y).sum() / mass.sum(), 1.0]
    points = np.stack([x, y, np.ones_like(x)], axis=1)
    return linprog(centre, A_ub=-points, b_ub=-100 * scene[outline], bounds=[(None, None)] * 3).fun / 100


@pytest.mark.parametrize("seed", range(12))
def test_the_plane_is_the_lowest_that_touches_nowhere_below(seed: int):
    rng = np.random.default_rng(seed)
    scene = rng.uniform(0, 0.02, DISC.shape) * (rng.random(DISC.shape) < 0.2)
    weight = rng.uniform(0.5, 1.5, DISC.shape)
    gap = resting_gap(scene, DISC, weight)
    points = np.stack([COLUMNS[DISC], ROWS[DISC], ONES[DISC]], axis=1)
    plane, *_ = np.linalg.lstsq(points, (scene + gap)[DISC], rcond=None)
    np.testing.assert_allclose(points @ plane, (scene + gap)[DISC], atol=1e-9)
    assert gap.min() > -2e-7
    centre = (weight[DISC, None] * points).sum(axis=0) / weight[DISC].sum()
    assert plane @ centre == pytest.approx(height_at_centre(scene, DISC, weight), abs=3e-7)


def test_nothing_is_below_an_item_on_a_slope_or_on_flat_ground():
    for scene in (np.zeros(DISC.shape), 0.001 * COLUMNS - 0.002 * ROWS):
        np.testing.assert_allclose(resting_gap(scene, DISC, ONES), 0, atol=2e-7)


def test_on_a_ridge_through_its_centre_it_is_carried_level_along_the_ridge():
    scene = np.where(ROWS == 11, 0.01, 0.0)
    gap = resting_gap(scene, DISC, ONES)
    np.testing.assert_allclose(gap[11, DISC[11]], 0, atol=2e-7)
    assert gap[4, 14] + gap[18, 14] == pytest.approx(0.02, abs=4e-7)


def test_without_an_item_there_is_no_plane():
    scene = np.random.default_rng(0).uniform(0, 0.02, DISC.shape)
    assert resting_plane(scene, np.zeros_like(DISC), ONES) == (0, 0, 0)


@pytest.mark.parametrize("cells", [1, 2])
def test_an_item_of_a_cell_or_two_rests_on_them(cells: int):
    outline = np.zeros_like(DISC)
    outline[5, 5 : 5 + cells] = True
    scene = np.where(COLUMNS == 5, 0.01, 0.005)
    np.testing.assert_allclose(resting_gap(scene, outline, ONES)[outline], 0, atol=2e-7)
