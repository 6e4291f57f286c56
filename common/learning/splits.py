"""Splits of samples by their groups: samples of one state never lie on both sides."""

import numpy as np
from numpy.typing import NDArray

Indices = NDArray[np.int64]


def split(groups: NDArray[np.integer], *, share: float, seed: int) -> tuple[Indices, Indices]:
    """Return the indices of the larger part and of about ``share`` of the groups, each increasing.

    Args:
        groups: Group of each sample ``(N,)``.
        share: Share of the groups in the second part, between 0 and 1; at least one group.
        seed: Seed of the draw.
    """
    order = np.random.default_rng(seed).permutation(np.unique(groups))
    held_out = np.isin(groups, order[: max(1, round(share * len(order)))])
    return np.flatnonzero(~held_out), np.flatnonzero(held_out)


def folds(groups: NDArray[np.integer], *, count: int, seed: int) -> NDArray[np.int64]:
    """Return the fold of each sample ``(N,)``, 0 to ``count - 1``, with nearly equal numbers of groups."""
    names, of_sample = np.unique(groups, return_inverse=True)
    of_group = np.empty(len(names), dtype=np.int64)
    of_group[np.random.default_rng(seed).permutation(len(names))] = np.arange(len(names)) % count
    return of_group[of_sample]
