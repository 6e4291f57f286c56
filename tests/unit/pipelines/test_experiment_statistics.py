"""Figures with intervals."""

import numpy as np
import pytest

from pipelines.experiments.statistics import Sample


def test_the_interval_of_a_mean_is_that_of_theory():
    rng = np.random.default_rng(3)
    values = rng.normal(5, 2, 400)
    found = Sample(np.arange(400)).mean(values)
    half = 1.96 * values.std() / 20
    assert found.value == pytest.approx(values.mean())
    assert found.high - found.value == pytest.approx(half, rel=0.1)
    assert found.value - found.low == pytest.approx(half, rel=0.1)


def test_samples_of_one_cluster_count_as_one():
    rng = np.random.default_rng(4)
    values = rng.normal(size=100)
    alone = Sample(np.arange(100)).mean(values)
    repeated = Sample(np.repeat(np.arange(100), 9)).mean(np.repeat(values, 9))
    assert repeated.high - repeated.low == pytest.approx(alone.high - alone.low, rel=0.1)


def test_a_paired_ratio_of_proportional_values_is_certain():
    values = np.array([1.0, 2.0, 5.0])
    found = Sample(np.arange(3)).ratio(0.3 * values, values)
    assert (found.low, found.value, found.high) == pytest.approx((0.3, 0.3, 0.3))


def test_a_paired_difference_knows_its_sign():
    values = np.array([[1.0, 4.0, 2.0], [1.5, 4.5, 2.5]])
    found = Sample(np.arange(3), seeds=2).difference(values - 0.2, values)
    assert (found.low, found.value, found.high) == pytest.approx((-0.2, -0.2, -0.2))


def test_seeds_that_differ_widen_the_interval():
    samples = Sample(np.arange(50), seeds=3)
    same = samples.mean(np.ones((3, 50)))
    apart = samples.mean(np.ones((3, 50)) * np.array([[0.5], [1.0], [1.5]]))
    assert same.high == pytest.approx(same.low)
    assert (apart.low, apart.high) == pytest.approx((0.5, 1.5), abs=0.2)


def test_the_median_is_numpys_and_its_interval_holds_it():
    for count in (1, 6, 7):
        values = np.random.default_rng(count).normal(size=count)
        found = Sample(np.arange(count)).median(values)
        assert found.value == pytest.approx(np.median(values))
        assert values.min() <= found.low <= found.value <= found.high <= values.max()
