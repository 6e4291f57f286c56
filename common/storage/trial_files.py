"""The files of a record of trials, for whoever reads it: nothing here writes, and nothing is locked."""

import re
from dataclasses import dataclass
from datetime import datetime
from pathlib import Path
from typing import Self

from pydantic import BaseModel, ConfigDict, Field, ValidationError

from common.domain.errors import RequestError
from common.domain.grid import Grid
from common.storage.cases import DEFAULT_TASK, read_about

PARTIAL = ".partial"
NAME = re.compile(r"(\d{6,})-.+-[0-9a-f]{12}\.npz")


class RecordedTrial(BaseModel):
    """What a trial's file says in words and single numbers.

    Attributes:
        number: Its place in the order of recording, from 1.
        robot: Who executed it.
        id: The report's identifier.
        received: When the recorder took it, with its time zone.
        digest: See `common.storage.trials.trial_digest`.
        task: Whose action it was.
        action: The executed action's parameters [m; rad].
        rows, columns, cell: The grid; the edge of a cell [m].
        rigid: Whether the item is one rigid body.
        item_volume: The item's volume [m3].
        added_volume: What the outcome adds to the scene [m3].
    """

    model_config = ConfigDict(frozen=True, extra="ignore", allow_inf_nan=False)

    number: int = Field(ge=1)
    robot: str
    id: str
    received: datetime
    digest: str = Field(pattern=r"^[0-9a-f]{64}$")
    task: str
    action: tuple[float, ...]
    rows: int
    columns: int
    cell: float
    rigid: bool
    item_volume: float
    added_volume: float

    @property
    def file(self) -> str:
        """Name of its file: names are in the order of recording."""
        return f"{self.number:06}-{self.robot}-{self.digest[:12]}.npz"

    @property
    def grid(self) -> Grid:
        """The grid of scene, item and outcome."""
        return Grid(self.rows, self.columns, self.cell)

    def entry(self) -> dict[str, object]:
        """Return what a case file does not say otherwise, as plain values."""
        return self.model_dump(mode="json", exclude={"task", "action", "cell"})

    @classmethod
    def read(cls, path: Path) -> Self:
        """Read it from a trial's file.

        Raises:
            RequestError: The file is not a trial, or has the name of another one.
        """
        about = read_about(path)
        entry = about.get("trial")
        if not isinstance(entry, dict):
            raise RequestError(f"{path}: expected a trial that a recorder took, got a case without it")
        known = {name: about.get(said) for name, said in (("action", "true_action"), ("cell", "cell"))}
        try:
            found = cls.model_validate(entry | known | {"task": about.get("task", DEFAULT_TASK)})
            found.grid  # noqa: B018
        except ValidationError as error:
            first = error.errors(include_url=False)[0]
            where = ".".join(str(part) for part in first["loc"])
            raise RequestError(f"{path}: expected a trial, got {where}: {first['msg']}") from None
        except RequestError as error:
            raise RequestError(f"{path}: {error}") from None
        if found.file != path.name:
            raise RequestError(f"{path}: expected the name {found.file}")
        return found


@dataclass(frozen=True)
class Record:
    """What a folder holds.

    Attributes:
        trials: Whole trials, in the order of recording.
        broken: A line about every other case file.
    """

    trials: tuple[RecordedTrial, ...]
    broken: tuple[str, ...]


def number_of(name: str) -> int | None:
    """Return a trial's number by the name of its file, None if it is no such name."""
    match = NAME.fullmatch(name)
    return int(match[1]) if match else None


def find_trials(folder: Path) -> Record:
    """Return the trials of a folder; of each file only the words are read, so that heightmaps may still be broken.

    Raises:
        RequestError: There is no such folder.
    """
    if not folder.is_dir():
        raise RequestError(f"expected a folder of trials, got {folder}, which does not exist")
    trials: list[RecordedTrial] = []
    broken: list[str] = []
    for path in folder.glob("[!.]*.npz"):
        try:
            trials.append(RecordedTrial.read(path))
        except RequestError as error:
            broken.append(str(error))
    return Record(tuple(sorted(trials, key=lambda trial: trial.number)), tuple(sorted(broken)))
