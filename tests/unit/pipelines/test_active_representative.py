"""Trials that look like what will be met."""

import numpy as np
import pytest

from common.domain.errors import RequestError
from pipelines.mde.active_representative import choose_representative, order_of

RNG = np.random.default_rng(0)


def test_the_first_choice_lies_in_the_middle_of_what_will_be_met():
    met = RNG.normal(size=(200, 3))
    candidates = np.array([[0.0, 0.0, 0.0], [3.0, 3.0, 3.0]])
    assert choose_representative(met, np.empty((0, 3)), candidates) == [0]


def test_what_was_tried_is_not_tried_again_while_something_else_is_to_be_met():
    met = np.concatenate([RNG.normal(-2, 0.1, (50, 2)), RNG.normal(2, 0.1, (50, 2))])
    tried = np.array([[-2.0, -2.0]])
    assert choose_representative(met, tried, np.array([[-2.0, -2.0], [2.0, 2.0]])) == [1]


def test_few_chosen_ones_have_a_mean_nearer_to_that_of_all_than_as_many_by_chance():
    points = RNG.standard_t(4, size=(240, 5))
    chosen = points[order_of(points, [3, 8], 20)].mean(axis=0)
    by_chance = [points[RNG.choice(240, 20, replace=False)].mean(axis=0) for _ in range(50)]
    distances = [np.linalg.norm(mean - points.mean(axis=0)) for mean in by_chance]
    assert np.linalg.norm(chosen - points.mean(axis=0)) < np.quantile(distances, 0.1)


def test_more_than_there_is_cannot_be_chosen():
    met = RNG.normal(size=(10, 2))
    with pytest.raises(RequestError, match="count: expected 1 to 4, the number of candidates, got 5"):
        choose_representative(met, met[:2], met[:4], count=5)


def test_an_order_begins_with_the_first_and_names_nobody_twice():
    points = RNG.normal(size=(30, 2))
    order = order_of(points, [5, 7], 30)
    assert order[:2] == [5, 7]
    assert sorted(order) == list(range(30))
