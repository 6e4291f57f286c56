"""The surface on which an item that bends would lie, against closed forms."""

import numpy as np
import pytest
from numpy.typing import NDArray

from common.learning.draping import bending_length, draped

EVERYWHERE = np.ones((40, 60), dtype=bool)


@pytest.fixture
def scene() -> NDArray[np.float32]:
    return np.random.default_rng(3).uniform(0, 2, (40, 60)).astype(np.float32)


def test_beside_a_step_it_falls_like_a_parabola_that_touches_the_floor():
    height, edge, curvature = 2.0, 20, 0.02
    step = np.zeros((40, 60), dtype=np.float32)
    step[:, : edge + 1] = height
    x = np.arange(60)
    expected = np.maximum(np.sqrt(height) - np.sqrt(curvature) * np.maximum(x - edge, 0), 0) ** 2
    np.testing.assert_allclose(draped(step, EVERYWHERE, curvature)[17], expected, atol=0.02)


def test_it_lies_on_the_scene_and_on_it_again(scene: NDArray[np.float32]):
    once = draped(scene, EVERYWHERE, 0.05)
    assert (once >= scene - 1e-5).all()
    np.testing.assert_allclose(draped(once, EVERYWHERE, 0.05), once, atol=1e-5)


def test_a_stiffer_item_lies_nowhere_lower(scene: NDArray[np.float32]):
    soft, stiff, rigid = (draped(scene, EVERYWHERE, curvature) for curvature in (1.0, 0.05, 1e-9))
    assert (soft <= stiff + 1e-5).all()
    assert (stiff <= rigid + 1e-5).all()
    np.testing.assert_allclose(rigid, scene.max(), atol=1e-4)


def test_only_what_is_below_the_item_carries_it(scene: NDArray[np.float32]):
    outline = np.zeros((40, 60), dtype=bool)
    outline[10:25, 5:30] = True
    mountain = scene.copy()
    mountain[:, 31:] += 50
    surface = draped(mountain, outline, 0.02)
    np.testing.assert_array_equal(surface[~outline], mountain[~outline])
    np.testing.assert_array_equal(surface[outline], draped(scene, outline, 0.02)[outline])
    np.testing.assert_array_equal(draped(scene, ~EVERYWHERE, 0.02), scene)


def test_an_item_ten_times_as_stiff_carries_itself_over_twice_the_span():
    assert bending_length(1e5, 1050, 0.02) == pytest.approx(10 ** (1 / 3) * bending_length(1e4, 1050, 0.02))
    assert bending_length(1e4, 1050, 0.02) == pytest.approx((1e4 * 4e-4 / (12 * 1050 * 9.81)) ** (1 / 3))
