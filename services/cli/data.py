"""``frugal data``: data sets of simulated placements."""

import re
import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING

import click

from common.domain.errors import RequestError
from common.domain.grid import Grid
from services.cli.asking import say

if TYPE_CHECKING:
    from common.storage.dataset_card import DatasetPlan
    from pipelines.data.generate import Report

NAME = click.option("--name", required=True, help="Name of the data set, a folder in --out.")
COUNT = click.IntRange(1, 1_000_000)


@click.group()
def data() -> None:
    """Generate, show and import data sets."""


@data.command()
@NAME
@click.option("--train", type=COUNT, default=1000, show_default=True, help="Settled training samples.")
@click.option("--test", type=COUNT, default=300, show_default=True, help="Settled test samples.")
@click.option("--seed", type=click.IntRange(0, 2**63 - 1), default=0, show_default=True)
@click.option(
    "--preset",
    type=click.Choice(["wide", "narrow"]),
    default="wide",
    show_default=True,
    help="Items of any kind, or one steak.",
)
@click.option("--level", type=click.Choice(["coarse", "default", "fine"]), default="default", show_default=True)
@click.option("--actions-per-state", type=click.IntRange(1, 64), default=2, show_default=True)
@click.option("--workers", type=click.IntRange(1, 256), default=2, show_default=True, help="Processes to work with.")
@click.option(
    "--out", type=click.Path(path_type=Path), default=Path("data"), show_default=True, help="Folder of the data sets."
)
def generate(
    *,
    name: str,
    train: int,
    test: int,
    seed: int,
    preset: str,
    level: str,
    actions_per_state: int,
    workers: int,
    out: Path,
) -> None:
    """Draw states and actions, simulate them, and write them as a data set.

    The same options give the same bytes, however many workers there are. A run that was interrupted goes on where it
    stopped when it is started again.
    """
    from common.storage.dataset_card import DatasetPlan, GridCard
    from pipelines.data.generate import generate as generate_dataset
    from pipelines.data.local import local_workers
    from services.simulator.model import SimulatorModel
    from services.simulator.settings import LEVELS

    if not re.fullmatch(r"[A-Za-z0-9][A-Za-z0-9._-]*", name):
        raise RequestError(f"expected a name of letters, digits, dots and dashes, got {name!r}")
    grid = Grid()
    plan = DatasetPlan(
        name=name,
        seed=seed,
        preset=preset,
        counts={"train": train, "test": test},
        actions_per_state=actions_per_state,
        grid=GridCard(rows=grid.rows, columns=grid.columns, cell=grid.cell),
        model=SimulatorModel.name,
        version=SimulatorModel.version,
        level=level,
        settings=asdict(LEVELS[level]),
    )
    began = time.perf_counter()
    with local_workers(plan, workers) as submit, _bars(plan) as report:
        made = generate_dataset(out / name, plan, submit=submit, in_flight=2 * workers, report=report)
    failed = sum(sum(reasons.values()) for reasons in made.card.failed.values())
    say(f"{train} + {test} samples in {out / name}, {failed} failed; {time.perf_counter() - began:.1f} s")


@contextmanager
def _bars(plan: "DatasetPlan") -> "Iterator[Report]":
    from rich.console import Console
    from rich.progress import (
        BarColumn,
        MofNCompleteColumn,
        Progress,
        TextColumn,
        TimeElapsedColumn,
        TimeRemainingColumn,
    )

    columns = (
        TextColumn("{task.description}"),
        BarColumn(),
        MofNCompleteColumn(),
        TimeElapsedColumn(),
        TimeRemainingColumn(),
    )
    with Progress(*columns, console=Console(stderr=True)) as progress:
        bars = {split: progress.add_task(split, total=count, start=False) for split, count in plan.counts.items()}

        def report(split: str, settled: int) -> None:
            bar = bars[split]  # type: ignore[index]
            progress.start_task(bar)
            progress.update(bar, completed=settled)

        yield report
