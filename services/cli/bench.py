"""``frugal bench``: measure a part of the system."""

import json
from dataclasses import asdict
from pathlib import Path

import click
from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeElapsedColumn, TimeRemainingColumn

from services.cli.bench_optimizer import optimizer
from services.simulator.settings import LEVELS


@click.group()
def bench() -> None:
    """Measure a part of the system."""


bench.add_command(optimizer)


@bench.command()
@click.option("--scenes", type=click.IntRange(1), default=50, show_default=True, help="Scenes of the sampler.")
@click.option(
    "--compare",
    type=click.IntRange(0),
    default=10,
    show_default=True,
    help="First scenes that also run at all levels and moved; later ones only where no fry moves, until as many.",
)
@click.option("--seed", type=click.IntRange(0), default=0, show_default=True)
@click.option("--level", type=click.Choice(list(LEVELS)), default="default", show_default=True)
@click.option("--device", default="cpu", show_default=True, help="Warp's name of the device.")
@click.option("--peers/--no-peers", default=True, show_default=True, help="Other simulators, where installed.")
@click.option("--memory", type=click.IntRange(0), default=0, help="Also compare memory after so many placements.")
@click.option("--records", type=click.Path(path_type=Path, dir_okay=False), help="File for every scene's record.")
@click.option("--json", "as_json", is_flag=True, help="The figures as JSON on standard output.")
def simulator(*, as_json: bool, records: Path | None, scenes: int, **chosen: object) -> None:
    """Measure the simulator: time, rest, penetration, levels, sensitivity, memory, and other simulators beside it.

    Times are wall times of one thread; on a machine that computes something else as well they are upper bounds,
    processor times stand beside them. Newton and MuJoCo are installed by the extra "bench".
    """
    from pipelines.bench.simulator import BenchOptions, bench_simulator
    from pipelines.bench.table import figures_table, levels_table

    options = BenchOptions(scenes=scenes, **chosen)  # type: ignore[arg-type]
    columns = (TextColumn("{task.description}"), BarColumn(), MofNCompleteColumn())
    console = Console(stderr=True)
    with Progress(*columns, TimeElapsedColumn(), TimeRemainingColumn(), console=console) as progress:
        row = progress.add_task("scenes", total=scenes)
        result = bench_simulator(
            options, report=lambda stage: progress.update(row, description=stage, advance=float(stage == "scenes"))
        )
    if records is not None:
        records.parent.mkdir(parents=True, exist_ok=True)
        records.write_text("".join(json.dumps(asdict(record)) + "\n" for record in result.records))
    if as_json:
        click.echo(json.dumps(result.figures, indent=2))
    else:
        console = Console()
        console.print(figures_table(result.figures))
        console.print(levels_table(result.figures))
