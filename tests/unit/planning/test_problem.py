"""What may be asked for."""

from dataclasses import replace

import numpy as np
import pytest
from planning_fakes import GRID, small_problem

from common.domain.errors import RequestError


def test_without_bounds_the_task_gives_its_own():
    problem = small_problem()
    np.testing.assert_array_equal(problem.limits, problem.task.bounds(problem.state))


def test_narrower_bounds_are_kept():
    bounds = np.array([[-0.01, 0.02], [0.0, 0.03]])
    np.testing.assert_array_equal(replace(small_problem(), bounds=bounds).limits, bounds)


@pytest.mark.parametrize(
    ("bounds", "complaint"),
    [
        ([[0.01, 0.01], [0, 0.01]], "smallest value below its largest"),
        ([[0.0, np.nan], [0, 0.01]], "finite"),
        ([[0.0, 0.01]], "expected 2 action parameters, got 1"),
        ([[-5.0, 5.0], [0, 0.01]], "within"),
        ([0.0, 0.01], "shape"),
    ],
)
def test_bounds_that_make_no_sense_are_refused(bounds, complaint: str):
    with pytest.raises(RequestError, match=complaint):
        replace(small_problem(), bounds=np.array(bounds))


@pytest.mark.parametrize(
    ("target", "complaint"),
    [(np.zeros((5, 5)), "shape"), (np.full(GRID.shape, np.nan), "finite"), (np.full(GRID.shape, 3.0), "at most 1 m")],
)
def test_a_target_that_is_no_heightmap_of_the_grid_is_refused(target, complaint: str):
    with pytest.raises(RequestError, match=complaint):
        replace(small_problem(), target=target)
