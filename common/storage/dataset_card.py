"""What is known about a data set: the plan it is made from, and the card it has once it is complete."""

import json
import os
from pathlib import Path
from typing import Annotated, Literal, Self

from pydantic import BaseModel, ConfigDict, Field, ValidationError

from common.domain.errors import RequestError
from common.domain.grid import Grid

FORMAT = "frugal-dataset-1"
Split = Literal["train", "test"]
SPLITS: tuple[Split, ...] = ("train", "test")


class Document(BaseModel):
    """A JSON file of a data set: finite numbers, no unknown fields."""

    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False)

    def write(self, path: Path) -> None:
        """Write the file; it appears whole or not at all."""
        unfinished = path.with_name(f".{path.name}.{os.getpid()}.partial")
        unfinished.write_text(self.model_dump_json(indent=1) + "\n")
        unfinished.replace(path)

    @classmethod
    def read(cls, path: Path) -> Self:
        """Read the file.

        Raises:
            RequestError: It is not what this version of the format says.
        """
        try:
            content = json.loads(path.read_text())
            if isinstance(content, dict) and content.get("format") != FORMAT:
                raise RequestError(f"{path}: expected the format {FORMAT}, got {content.get('format')!r}")
            return cls.model_validate(content)
        except ValidationError as error:
            first = error.errors()[0]
            where = ".".join(str(part) for part in first["loc"])
            raise RequestError(f"{path}: {where}: {first['msg']}, got {first['input']!r:.100}") from None
        except ValueError as error:
            raise RequestError(f"{path}: expected JSON, got something else: {error}") from None


class GridCard(BaseModel):
    """Rows along y, columns along x, and the edge of a square cell [m]."""

    model_config = ConfigDict(frozen=True, extra="forbid")

    rows: int
    columns: int
    cell: float

    def grid(self) -> Grid:
        """Return the grid."""
        return Grid(self.rows, self.columns, self.cell)


class DatasetPlan(Document):
    """Everything that a data set's samples follow from.

    Attributes:
        format: Version of the format on disk.
        name: Name of the data set.
        seed: Seed of every random choice.
        preset: Which states and actions are drawn.
        counts: Settled samples wanted in each split.
        actions_per_state: Actions tried in each state.
        grid: The grid of all heightmaps.
        model: Name of the model that made the outcomes.
        version: Its version.
        level: Its level of resolution.
        settings: Its settings.
    """

    format: Literal["frugal-dataset-1"] = FORMAT
    name: str
    seed: Annotated[int, Field(ge=0)]
    preset: str
    counts: dict[Split, Annotated[int, Field(ge=1)]]
    actions_per_state: Annotated[int, Field(ge=1)]
    grid: GridCard
    model: str
    version: str
    level: str
    settings: dict[str, float]


class DatasetCard(DatasetPlan):
    """The plan of a complete data set, and what came of it.

    Attributes:
        states: States drawn for each split.
        failed: Samples that did not come to rest or could not be simulated, by split and reason.
        ranges: Smallest and largest value of each quantity over the settled training samples, SI units.
        deviation_scale_m: The deviation that estimates call 1 [m]; None until it has been fixed.
        sha256: Of each split's ``states.jsonl``.
    """

    states: dict[Split, int]
    failed: dict[Split, dict[str, int]]
    ranges: dict[str, tuple[float, float]]
    deviation_scale_m: float | None = None
    sha256: dict[Split, str]
