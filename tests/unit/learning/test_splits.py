"""Splits by group."""

import numpy as np

from common.learning.splits import folds, split

GROUPS = np.repeat(np.arange(50), 3)


def test_no_group_lies_on_both_sides_and_the_share_is_kept():
    first, second = split(GROUPS, share=0.2, seed=1)
    assert sorted([*first, *second]) == list(range(150))
    assert not set(GROUPS[first]) & set(GROUPS[second])
    assert len(second) == 30


def test_the_seed_decides():
    np.testing.assert_array_equal(split(GROUPS, share=0.2, seed=1)[1], split(GROUPS, share=0.2, seed=1)[1])
    assert set(split(GROUPS, share=0.2, seed=1)[1]) != set(split(GROUPS, share=0.2, seed=2)[1])


def test_each_group_is_in_one_of_equal_folds():
    found = folds(GROUPS, count=4, seed=0)
    assert all(len(set(found[group == GROUPS])) == 1 for group in range(50))
    assert sorted(np.bincount(found) // 3) == [12, 12, 13, 13]
