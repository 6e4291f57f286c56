"""``frugal data``: data sets of simulated placements."""

import re
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from common.domain.errors import RequestError
from common.domain.grid import Grid
from services.cli.asking import say
from services.cli.data_import import import_depth
from services.cli.data_real import real

if TYPE_CHECKING:
    from common.storage.dataset_card import DatasetPlan, Split
    from pipelines.data.generate import Report, Submit

NAME = click.option("--name", required=True, help="Name of the data set, a folder in --out.")
OUT = click.option(
    "--out", type=click.Path(path_type=Path), default=Path("data"), show_default=True, help="Folder of the data sets."
)
FIGURES = (".png", ".svg", ".pdf")
COUNT = click.IntRange(1, 1_000_000)


@click.group()
def data() -> None:
    """Generate, show and import data sets."""


@data.command()
@NAME
@OUT
@click.option("--train", type=COUNT, default=4000, show_default=True, help="Settled training samples.")
@click.option("--test", type=COUNT, default=300, show_default=True, help="Settled test samples.")
@click.option("--seed", type=click.IntRange(0, 2**63 - 1), default=0, show_default=True)
@click.option(
    "--preset",
    type=click.Choice(["wide", "narrow"]),
    default="wide",
    show_default=True,
    help="Items of any kind, or the paper's one steak.",
)
@click.option("--level", type=click.Choice(["coarse", "default", "fine"]), default="default", show_default=True)
@click.option("--actions-per-state", type=click.IntRange(1, 64), default=2, show_default=True)
@click.option("--workers", type=click.IntRange(1, 256), default=2, show_default=True, help="Processes of this machine.")
@click.option(
    "--via",
    type=click.Choice(["processes", "zenoh"]),
    default="processes",
    show_default=True,
    help="Who simulates: processes of this machine, or all live simulator workers.",
)
def generate(*, name: str, out: Path, train: int, test: int, workers: int, via: str, **options: Any) -> None:
    """Draw states and actions, simulate them, and write them as a data set.

    The same options give the same bytes, however many workers there are. A run that was interrupted goes on where it
    stopped when it is started again. With --via zenoh the fries are settled by processes of this machine, and all
    live simulator workers place the items, those that join later too.
    """
    from pipelines.data.generate import generate as generate_dataset

    path, plan = find_folder(out, name), _plan(name, {"train": train, "test": test}, **options)
    began = time.perf_counter()
    with _workers(plan, via=via, workers=workers) as (submit, in_flight), _bars(plan) as report:
        made = generate_dataset(path, plan, submit=submit, in_flight=in_flight, report=report)
    failed = sum(sum(reasons.values()) for reasons in made.card.failed.values())
    say(f"{train} + {test} samples in {path}, {failed} more failed; {time.perf_counter() - began:.1f} s")


def find_folder(out: Path, name: str) -> Path:
    """Return the folder of a data set.

    Raises:
        RequestError: The name is no name of a folder.
    """
    if not re.fullmatch(r"[A-Za-z0-9][A-Za-z0-9._-]*", name):
        raise RequestError(f"expected a name of letters, digits, dots, dashes and underscores, got {name!r}")
    return out / name


def _plan(
    name: str, counts: "dict[Split, int]", *, seed: int, preset: str, level: str, actions_per_state: int
) -> "DatasetPlan":
    from common.storage.dataset_card import DatasetPlan, GridCard
    from services.simulator.model import SimulatorModel

    grid, model = Grid(), SimulatorModel.at_level(level)
    return DatasetPlan(
        name=name,
        seed=seed,
        preset=preset,
        counts=counts,
        actions_per_state=actions_per_state,
        grid=GridCard(rows=grid.rows, columns=grid.columns, cell=grid.cell),
        model=model.name,
        version=model.version,
        level=level,
        settings=asdict(model.settings),
    )


@contextmanager
def _workers(plan: "DatasetPlan", *, via: str, workers: int) -> "Iterator[tuple[Submit, Callable[[], int]]]":
    """Yield what starts the work on a state, and what tells how many should be at work."""
    if via == "processes":
        from pipelines.data.local import local_workers

        with local_workers(plan, workers) as submit:
            yield submit, lambda: 2 * workers
        return
    from common.wire.session import open_session
    from common.wire.settings import WireSettings
    from pipelines.data.remote import remote_workers

    with (
        open_session(WireSettings()) as session,
        remote_workers(plan, session, task="plating", settlers=workers) as remote,
    ):
        yield remote.submit, remote.in_flight


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

        def report(split: "Split", settled: int) -> None:
            bar = bars[split]
            progress.start_task(bar)
            progress.update(bar, completed=settled)

        yield report


@data.command()
@NAME
@click.option(
    "--data",
    "folder",
    type=click.Path(path_type=Path),
    default=Path("data"),
    show_default=True,
    help="Folder of the data sets.",
)
@click.option("--split", type=click.Choice(["train", "test"]), default="train", show_default=True)
@click.option("--count", type=click.IntRange(1, 200), default=12, show_default=True, help="Samples on the sheet.")
@click.option("--out", type=click.Path(path_type=Path), help="The figure: .png, .svg or .pdf.")
@click.option("--json", "as_json", is_flag=True, help="The card as JSON on standard output.")
def show(*, name: str, folder: Path, split: "Split", count: int, out: Path | None, as_json: bool) -> None:
    """Draw a contact sheet and the distributions of a data set, or print its card."""
    from common.storage.dataset import Dataset

    dataset = Dataset.open(find_folder(folder, name))
    if as_json:
        click.echo(dataset.card.model_dump_json(indent=1))
    elif out is None:
        raise RequestError("expected --out for a figure or --json for the card, got neither")
    if out is not None:
        if out.suffix not in FIGURES:
            raise RequestError(f"--out: expected a file of {', '.join(FIGURES)}, got {out}")
        from pipelines.data.show import draw_dataset

        draw_dataset(dataset, split, count=count).savefig(out, dpi=110)
        say(f"drawn in {out}")


data.add_command(import_depth)
data.add_command(real)
