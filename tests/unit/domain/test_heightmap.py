"""Shifting images."""

import numpy as np
import pytest
from scipy import ndimage

from common.domain.heightmap import shift

RNG = np.random.default_rng(0)
IMAGE = RNG.random((12, 17)).astype(np.float32)


@pytest.mark.parametrize(("columns", "rows"), [(0, 0), (3, -2), (-5, 4), (16, 11)])
def test_a_shift_by_whole_cells_moves_the_numbers_unchanged(columns: int, rows: int):
    expected = np.zeros_like(IMAGE)
    for r in range(12):
        for c in range(17):
            if 0 <= r - rows < 12 and 0 <= c - columns < 17:
                expected[r, c] = IMAGE[r - rows, c - columns]
    np.testing.assert_array_equal(shift(IMAGE, columns, rows), expected)


@pytest.mark.parametrize(("columns", "rows"), [(0.5, 0.0), (1.25, -2.75), (-3.1, 0.9)])
def test_a_shift_by_parts_of_a_cell_is_bilinear(columns: float, rows: float):
    padded = np.pad(IMAGE.astype(float), 20)
    expected = ndimage.shift(padded, (rows, columns), order=1)[20:-20, 20:-20]
    np.testing.assert_allclose(shift(IMAGE, columns, rows), expected, atol=1e-6)


def test_a_shift_beyond_the_image_leaves_nothing():
    assert not shift(IMAGE, 40, 0).any()
    assert not shift(IMAGE, 0, -12).any()


def test_every_channel_is_shifted_alike():
    stack = np.stack([IMAGE, 2 * IMAGE])
    np.testing.assert_array_equal(shift(stack, 1.5, 2.5)[1], 2 * shift(IMAGE, 1.5, 2.5))
