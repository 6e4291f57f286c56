"""The report: every experiment's numbers beside the paper's, as Markdown with figures and as JSON."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from common.domain.errors import RequestError
from pipelines.experiments.experiment import Experiment, PaperValue
from pipelines.experiments.measurements import find_raw
from pipelines.experiments.numbers import Number, filled, written
from pipelines.experiments.raw import Raw
from pipelines.experiments.shown import Shown
from pipelines.experiments.views import VIEWS

FIGURES, DOCUMENT = "figures", "results.md"
HEAD = """# Results

Every table and figure of the paper's evaluation with its numbers beside ours. Written by `frugal report` from the raw
results of `frugal evaluate --all`; `frugal report --json` prints every number with its seeds and its samples. Intervals
are bootstrap intervals over states or targets, and over seeds where there are several. The paper's robot, kitchen and
simulator are not here: "real" is a [stand-in](how-to/reproduce-the-paper.md), so what can be compared is the order of
methods and their ratios. Measurements of single parts and of other strategies are in [measurements](measurements.md).
"""


@dataclass(frozen=True)
class Section:
    """One experiment in the report.

    Attributes:
        experiment: The experiment.
        results: Its raw results; empty if there are none.
        shown: Its numbers and figure; None if it has no raw results.
        missing: What is missing, empty if nothing.
    """

    experiment: Experiment
    results: Mapping[str, Raw]
    shown: Shown | None
    missing: str = ""


def make_sections(experiments: Sequence[Experiment], raw: Path, *, partial: bool = False) -> tuple[Section, ...]:
    """Return every experiment with what its raw results say.

    Args:
        experiments: The experiments.
        raw: Folder of all raw results.
        partial: Whether an experiment without raw results is told of instead of an error.

    Raises:
        RequestError: An experiment of ``--all`` has no or incomplete raw results.
    """
    sections: list[Section] = []
    for experiment in experiments:
        try:
            results = find_raw(experiment, raw)
        except RequestError as error:
            if not partial and experiment.in_all:
                raise
            sections.append(Section(experiment, {}, None, str(error)))
            continue
        sections.append(Section(experiment, results, VIEWS[experiment.view](experiment, results)))
    return tuple(sections)


def write_report(sections: Sequence[Section], out: Path) -> Path:
    """Write the document and its figures, and return the document's path."""
    folder = out / FIGURES
    folder.mkdir(parents=True, exist_ok=True)
    for section in sections:
        if section.shown is not None and section.shown.figure is not None:
            section.shown.figure.savefig(folder / f"{section.experiment.name}.png", dpi=110)
    path = out / DOCUMENT
    path.write_text("\n".join([HEAD, *(_section(section) for section in sections)]))
    return path


def as_json(sections: Sequence[Section]) -> list[dict[str, Any]]:
    """Return every number of the report."""
    return [one.as_json() for section in sections if section.shown for one in section.shown.numbers]


def _section(section: Section) -> str:
    experiment, shown = section.experiment, section.shown
    parts = [f"## {experiment.of}: {experiment.title}"]
    if shown is None:
        return "\n".join([*parts, f"Not measured: `frugal evaluate {experiment.name}`.", ""])
    numbers = {one.key: one for one in shown.numbers}
    parts.append(filled(experiment.about.strip(), numbers))
    if shown.figure is not None:
        parts.append(f"![{experiment.title}]({FIGURES}/{experiment.name}.png)")
    parts.append("\n".join(_table(shown.numbers)))
    if experiment.note:
        parts.append(filled(experiment.note.strip(), numbers))
    sources = map(_source, experiment.measurements.values(), section.results.values())
    parts.append(f"`frugal evaluate {experiment.name}`; {'; '.join(sources)}.")
    return "\n\n".join(parts) + "\n"


def _table(numbers: Sequence[Number]) -> list[str]:
    """Return the lines of a table with a cell for each number, and how many samples each row rests on."""
    columns = tuple(dict.fromkeys(one.column for one in numbers))
    cells = {(one.row, one.column): one for one in numbers}
    lines = [f"| | {' | '.join(columns)} | n |", "|---" * (len(columns) + 2) + "|"]
    for row in dict.fromkeys(one.row for one in numbers):
        found = [cells.get((row, column)) for column in columns]
        counts = dict.fromkeys(str(one.samples) for one in found if one)
        texts = [_cell(one) if one else "" for one in found]
        lines.append(f"| {row} | {' | '.join(texts)} | {', '.join(counts)} |")
    return lines


def _cell(one: Number) -> str:
    parts = [f"**{written(one.value)}**"]
    if one.std is not None:
        parts.append(f"({written(one.std)})")
    parts.append(one.unit)
    if one.low is not None and one.high is not None and one.low != one.high:
        parts.append(f"[{written(one.low)}, {written(one.high)}]")
    text = " ".join(part for part in parts if part)
    return text if one.paper is None else f"{text}<br>*paper: {_paper(one.paper)}*"


def _paper(paper: PaperValue) -> str:
    if paper.text or paper.value is None:
        return paper.text or paper.where
    spread = "" if paper.std is None else f" ({paper.std:g})"
    return f"{paper.value:g}{spread} {paper.unit}".strip()


def _source(parameters: Any, raw: Raw) -> str:
    weights = ", ".join(f"{name} {sha[:8]}" for name, (_, sha) in raw.header.get("weights", {}).items())
    seeds = ", ".join(map(str, raw.header["seeds"]))
    text = f"raw results `{parameters.folder}`, seed {seeds}"
    return f"{text}, weights {weights}" if weights else text
