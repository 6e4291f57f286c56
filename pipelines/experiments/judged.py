"""What MDEs of several seeds say about the same samples."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from common.domain.errors import RequestError
from pipelines.experiments.raw import Row


@dataclass(frozen=True)
class Judged:
    """Judgements of S trainings about N samples.

    Attributes:
        seeds: Of the trainings.
        groups: Number of each sample's state ``(N,)``.
        errors: ``|estimate - truth|``, scaled to [0, 1] ``(S, N)``.
        constant: The same of a constant, the median of the training data ``(S, N)``.
    """

    seeds: tuple[int, ...]
    groups: NDArray[np.int64]
    errors: NDArray[np.float64]
    constant: NDArray[np.float64]

    @classmethod
    def of(cls, rows: Sequence[Row]) -> "Judged":
        """Return rows by seed and sample.

        Raises:
            RequestError: A seed has not judged every sample once.
        """
        seeds = tuple(sorted({row["seed"] for row in rows}))
        samples = sorted({row["sample"] for row in rows})
        found = {(row["seed"], row["sample"]): row for row in rows}
        if len(rows) != len(seeds) * len(samples) or len(found) != len(rows):
            raise RequestError(
                f"expected {len(seeds)} seeds with one judgement of {len(samples)} samples each, got {len(rows)}"
            )
        table = [[found[seed, sample] for sample in samples] for seed in seeds]
        truth, mean, constant = (
            np.array([[row[name] for row in line] for line in table], dtype=np.float64)
            for name in ("truth", "mean", "constant")
        )
        groups = np.array([row["group"] for row in table[0]], dtype=np.int64)
        return cls(seeds, groups, np.abs(mean - truth), np.abs(constant - truth))
