"""Numbers of the report: ours with a 95% interval, beside the paper's."""

import re
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from typing import Any

from common.domain.errors import RequestError
from pipelines.experiments.experiment import Experiment, PaperValue
from pipelines.experiments.statistics import Estimate

PLACEHOLDER = re.compile(r"\{([^{}]+)\}")


@dataclass(frozen=True)
class Number:
    """One number.

    Attributes:
        experiment: Name of its experiment.
        key: What it is, unique in its experiment.
        row: Its line in the table.
        column: Its column.
        value: The number.
        low: Lower end of its 95% interval; None where it rests on one sample.
        high: Upper end.
        std: Standard deviation of what it is the mean of; None where that is not told.
        unit: Its unit.
        seeds: Seeds that it rests on.
        samples: Samples, targets or trials that it rests on.
        paper: What the paper has.
    """

    experiment: str
    key: str
    row: str
    column: str
    value: float
    low: float | None
    high: float | None
    std: float | None
    unit: str
    seeds: tuple[int, ...]
    samples: int
    paper: PaperValue | None = None

    def as_json(self) -> dict[str, Any]:
        """Return it ready for JSON; ``paper`` is null where the paper prints no number."""
        printed = self.paper if self.paper is not None and self.paper.value is not None else None
        return {
            **asdict(self),
            "label": f"{self.row}: {self.column}",
            "seeds": list(self.seeds),
            "paper": printed and printed.model_dump(exclude={"key"}),
        }


def number(
    experiment: Experiment,
    key: str,
    at: tuple[str, str],
    found: Estimate,
    unit: str,
    *,
    seeds: Sequence[int],
    samples: int,
    std: float | None = None,
) -> Number:
    """Return a number, its row and column ``at``, with what the paper has for it."""
    paper = next((one for one in experiment.paper if one.key == key), None)
    low, high = (found.low, found.high) if samples > 1 else (None, None)
    return Number(
        experiment.name, key, *at, found.value, low, high, std, unit, tuple(seeds), samples, paper
    )  # fmt: skip


def written(value: float | None) -> str:
    """Return a number with three significant digits, never as a power of ten."""
    if value is None:
        return "-"
    if value == 0:
        return "0"
    places = 2 - int(f"{value:.2e}".partition("e")[2])
    return f"{value:.{max(places, 0)}f}"


def filled(text: str, numbers: Mapping[str, Number]) -> str:
    """Return text in which every ``{key}`` has become the number with its unit.

    Raises:
        RequestError: There is no number of that key.
    """

    def replaced(found: re.Match[str]) -> str:
        if found[1] not in numbers:
            raise RequestError(f"expected a number of {', '.join(numbers)}, got {{{found[1]}}}")
        one = numbers[found[1]]
        return f"{written(one.value)} {one.unit}".strip()

    return PLACEHOLDER.sub(replaced, text)
