"""Bounds in different units, some of them closed to circles."""

from dataclasses import replace

import numpy as np
import pytest
from planning_fakes import small_problem

from common.planning.gp import matern52
from common.planning.problem import Problem
from common.planning.space import Space, embed
from common.planning.ucb import design
from common.tasks import TASKS

PLANE = Space.of(small_problem())
YAWED = Space.of(replace(small_problem(), task=TASKS["plating_yaw"], bounds=None))
RNG = np.random.default_rng(0)


def yawed(bounds) -> Space:
    found = small_problem()
    return Space.of(Problem(TASKS["plating_yaw"], found.state, found.target, np.array(bounds)))


def test_only_a_parameter_whose_bounds_span_its_period_is_a_circle():
    assert not PLANE.circular.any()
    assert YAWED.circular.tolist() == [False, False, True]
    assert not yawed([[-0.05, 0.05], [-0.05, 0.05], [-3.0, 3.0]]).circular.any()


def test_on_a_circle_gaps_are_the_short_way_round():
    almost = np.pi - 0.01
    gap = YAWED.gaps(np.array([0.02, 0.0, almost]), np.array([0.0, 0.01, -almost]))
    np.testing.assert_allclose(gap, [0.02, -0.01, -0.02])


def test_what_leaves_the_bounds_is_moved_to_them_and_what_leaves_a_circle_comes_round():
    low, high = YAWED.limits.T
    inside = YAWED.confine(np.array([[0.5, -0.5, np.pi + 0.1], [0.01, 0.02, 0.3]]))
    np.testing.assert_allclose(inside, [[high[0], low[1], -np.pi + 0.1], [0.01, 0.02, 0.3]])


def test_without_circles_nothing_but_the_difference_is_computed():
    actions, others = RNG.uniform(-0.1, 0.1, (2, 20, 2))
    np.testing.assert_array_equal(PLANE.gaps(actions, others), actions - others)
    assert embed(actions, PLANE.circular) is actions


def test_embedded_circles_keep_small_distances_and_have_no_seam():
    circular = np.array([False, True])
    near, across, there = embed(np.array([[0.2, 0.001], [0.2, 0.999], [0.2, 0.003]]), circular)
    assert np.linalg.norm(near - across) == pytest.approx(0.002, rel=1e-3)
    assert np.linalg.norm(near - there) == pytest.approx(0.002, rel=1e-3)


def test_a_kernel_over_embedded_points_is_positive_definite():
    points = embed(RNG.random((80, 3)), np.array([False, True, True]))
    kernel = matern52(points, points, np.full((1, points.shape[1]), 0.18))[0]
    assert np.linalg.eigvalsh(kernel).min() > 0


@pytest.mark.parametrize("dimensions", [1, 2, 3, 4, 6])
@pytest.mark.parametrize("side", [3, 5, 17])
def test_a_design_holds_its_middle_and_few_values_of_each_coordinate(dimensions: int, side: int):
    points = design(side, dimensions)
    assert len(points) <= max(side ** min(dimensions, 2), (dimensions - 1) * side**2)
    assert (np.abs(points - 0.5).max(axis=1) < 1e-12).any()
    assert all(len(np.unique(column)) == side for column in points.T)
    assert len(np.unique(points, axis=0)) == len(points)
