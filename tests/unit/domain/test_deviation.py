"""Deviation and reward."""

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from common.domain.deviation import deviation
from common.tasks import TASKS


@given(st.integers(0, 2**32 - 1))
def test_a_deviation_bounds_the_error_of_a_reward(seed: int):
    rng = np.random.default_rng(seed)
    fast, trusted, target = rng.normal(0, 0.02, (3, 9, 11))
    task = TASKS["plating"]
    error = abs(float(task.reward(fast, target) - task.reward(trusted, target)))
    assert error <= float(deviation(fast, trusted)) + 1e-12


def test_the_deviation_is_the_mean_absolute_height_difference_of_each_prediction():
    target = np.zeros((4, 5))
    predictions = np.stack([target, target + 0.002, target - 0.004])
    np.testing.assert_allclose(deviation(predictions, target), [0, 0.002, 0.004])
