"""An experiment: one table or figure of the paper, what makes its raw results, and how they are shown."""

import tomllib
from pathlib import Path

from pydantic import BaseModel, Field, ValidationError

from common.domain.errors import RequestError
from pipelines.experiments.parameters import AnyParameters

FOLDER = Path(__file__).parent
"""The paper's experiments."""


class PaperValue(BaseModel, extra="forbid", frozen=True):
    """What the paper has for a number.

    Attributes:
        key: Key of the number.
        value: Its value, in the unit that the paper prints; None where it draws a bar without a number.
        std: The standard deviation that it prints.
        unit: The unit as printed.
        text: The value as printed, where that is more than a number.
        where: Where it is.
    """

    key: str
    value: float | None = None
    std: float | None = None
    unit: str = ""
    text: str = ""
    where: str = ""


class Series(BaseModel, extra="forbid", frozen=True):
    """One bar or line of a figure.

    Attributes:
        key: First part of its numbers' keys.
        label: What a reader sees.
        method: Name of the method in the raw results.
        measurement: Name of the measurement in the experiment; empty: the first.
        before: Key of the series that it is an improvement of; empty: of none.
    """

    key: str
    label: str
    method: str
    measurement: str = ""
    before: str = ""


class Experiment(BaseModel, extra="forbid", frozen=True):
    """One table or figure.

    Attributes:
        name: Name of its file.
        title: What it is.
        of: What of the paper it is, for instance ``Table I``.
        order: Its place in the report.
        about: What was done; ``{key}`` stands for a number.
        note: What it says; ``{key}`` stands for a number.
        in_all: Whether ``--all`` has it.
        measurements: What makes the raw results, by name.
        view: How raw results become numbers and a figure, see `pipelines.experiments.views`.
        series: Bars or lines, in their order.
        paper: The paper's values.
    """

    name: str
    title: str
    of: str
    order: int
    about: str
    note: str = ""
    in_all: bool = True
    measurements: dict[str, AnyParameters] = Field(min_length=1)
    view: str
    series: tuple[Series, ...] = ()
    paper: tuple[PaperValue, ...] = ()

    @property
    def needed(self) -> frozenset[str]:
        """Return the names of the data sets and trial folders that its measurements read."""
        return frozenset().union(*(each.needed for each in self.measurements.values()))


def read_experiment(path: Path) -> Experiment:
    """Read an experiment from its TOML file.

    Raises:
        RequestError: It is none, or has a field that no experiment has.
    """
    try:
        content = tomllib.loads(path.read_text())
        found = Experiment.model_validate({"name": path.stem, **content})
    except tomllib.TOMLDecodeError as error:
        raise RequestError(f"{path}: expected TOML, got something else: {error}") from None
    except ValidationError as error:
        first = error.errors()[0]
        where = ".".join(str(part) for part in first["loc"])
        raise RequestError(f"{path}: {where}: {first['msg']}, got {first['input']!r:.80}") from None
    unknown = {one.measurement for one in found.series} - {"", *found.measurements}
    if unknown:
        raise RequestError(
            f"{path}: series: expected a measurement of {', '.join(found.measurements)}, got {', '.join(unknown)}"
        )
    keys = {one.key for one in found.series}
    if strange := {one.before for one in found.series} - {"", *keys}:
        raise RequestError(f"{path}: series: expected before to be one of {', '.join(keys)}, got {', '.join(strange)}")
    return found


def read_experiments(folder: Path = FOLDER) -> tuple[Experiment, ...]:
    """Read all experiments of a folder, in the order of the report.

    Raises:
        RequestError: There is none, or one is not valid.
    """
    found = [read_experiment(path) for path in sorted(folder.glob("*.toml"))]
    if not found:
        raise RequestError(f"expected experiments (*.toml) in {folder}, got none")
    return tuple(sorted(found, key=lambda one: one.order))
