"""Cases that measurements are made on, read when they are asked for."""

import hashlib
from abc import ABC, abstractmethod
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from common.domain.case import Case
from common.domain.errors import RequestError
from common.storage.cases import read_case
from common.storage.dataset import Dataset
from common.storage.dataset_card import Split
from pipelines.experiments.parameters import Cases


class CaseSet(ABC):
    """Cases by number, from 0."""

    @abstractmethod
    def case(self, index: int) -> Case:
        """Return a case; its target is the outcome of its true action."""

    @abstractmethod
    def about(self) -> dict[str, Any]:
        """Return what they are, with a digest of their content."""

    groups: NDArray[np.int64]
    """Number of each case's state ``(N,)``; cases of one state are not independent."""

    def __len__(self) -> int:
        """Return N."""
        return len(self.groups)


class DatasetCases(CaseSet):
    """Samples of one split of a data set.

    Args:
        path: Its folder.
        wanted: Which samples.
    """

    def __init__(self, path: Path, wanted: Cases) -> None:
        self._dataset = Dataset.open(path)
        self._split: Split = wanted.split
        self._samples = self._dataset.samples(wanted.split)
        groups = self._samples.groups
        taken = np.unique(groups, return_index=True)[1] if wanted.per_state else np.arange(len(groups))
        self._taken = taken[_spread(len(taken), wanted.count, path)]
        self.groups = groups[self._taken]

    def case(self, index: int) -> Case:
        """Return a sample as a case."""
        sample, group = int(self._taken[index]), int(self.groups[index])
        x, y = self._samples.actions[sample].tolist()
        return Case(
            f"{self._dataset.card.name}-{self._split}-{sample:05d}",
            self._dataset.card.seed,
            self._dataset.state(self._split, group),
            self._samples.outcomes[sample],
            (x, y),
            same_item=True,
        )

    def about(self) -> dict[str, Any]:
        """Return name, seed and version of the data set, and the digest of its states."""
        card = self._dataset.card
        return {"name": card.name, "seed": card.seed, "version": card.version, "sha256": card.sha256[self._split]}


class TrialCases(CaseSet):
    """Trials in folders of case files.

    Args:
        data: Where the folders are.
        wanted: Which of them.
    """

    def __init__(self, data: Path, wanted: Cases) -> None:
        files: list[Path] = []
        for name in wanted.trials:
            found = sorted((data / name).glob("[!.]*.npz"))
            if not found:
                raise RequestError(f"expected trials (*.npz) in {data / name}, got none")
            files += found
        self._files = [files[index] for index in _spread(len(files), wanted.count, data / wanted.trials[0])]
        self._name = ", ".join(wanted.trials)
        digests = [self.case(index).state.digest for index in range(len(self._files))]
        self.groups = np.unique(digests, return_inverse=True)[1]

    def case(self, index: int) -> Case:
        """Return a trial.

        Raises:
            RequestError: It has no action.
        """
        case = read_case(self._files[index])
        if case.true_action is None:
            raise RequestError(f"{self._files[index]}: expected a trial with its action, got none")
        return case

    def about(self) -> dict[str, Any]:
        """Return the folders' names and the digest of all files."""
        digest = hashlib.sha256()
        for file in self._files:
            digest.update(file.read_bytes())
        return {"name": self._name, "sha256": digest.hexdigest()}


@cache
def find_cases(data: Path, wanted: Cases) -> CaseSet:
    """Return cases below the folder of data sets; what is read stays with the process.

    Raises:
        RequestError: They are not there, or fewer than wanted.
    """
    if wanted.data:
        return DatasetCases(data / wanted.data, wanted)
    return TrialCases(data, wanted)


def _spread(there: int, count: int | None, path: Path) -> NDArray[np.int64]:
    if count is None:
        return np.arange(there)
    if count > there:
        raise RequestError(f"{path}: expected {count} cases, got {there}")
    return np.linspace(0, there - 1, count).round().astype(np.int64)
