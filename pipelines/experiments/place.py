"""Where a measurement finds what it needs."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path

Report = Callable[[int, int], None]
"""Is told how many jobs are done, of how many."""


@dataclass(frozen=True)
class Place:
    """Folders of one run.

    Attributes:
        models: Released weights.
        data: Data sets and trials.
        raw: Raw results, a folder for each measurement.
        workers: Processes where several may run at the same time.
    """

    models: Path
    data: Path
    raw: Path
    workers: int = 1

    def weights(self, folders: Mapping[str, str]) -> dict[str, Path]:
        """Return the folders of weights by the name of whose they are.

        Args:
            folders: Folder below the released weights, by name.
        """
        return {name: self.models / folder for name, folder in folders.items()}
