"""``frugal data real``."""

from pathlib import Path

import click

from services.cli.asking import say
from services.cli.progress import bars


@click.command("real")
@click.option("--name", default="real-v1", show_default=True, help="Name of the folder in data/.")
@click.option("--workers", type=click.IntRange(1, 64), default=2, show_default=True, help="Processes.")
def real(*, name: str, workers: int) -> None:
    """Make trials in the world's stand-in, as a robot with a wrist camera would: 80 to learn from, 20 and 200 to test.

    A case file each, in data/NAME/train, test and more; data/NAME/pool has six actions on each of 40 tables, for the
    choice of actions. A run that was interrupted is gone on with.
    """
    make_real(Path("data") / name, workers=workers)


def make_real(folder: Path, *, workers: int) -> None:
    """Make the trials that are missing in a folder."""
    from pipelines.data.local import local_processes
    from pipelines.data.real import COUNTS, generate_real

    with bars() as progress, local_processes(workers) as processes:
        row = progress.add_task("tables", total=sum(COUNTS.values()))
        generate_real(folder, processes, report=lambda done: progress.update(row, completed=done))
    say(f"written: {folder}, {', '.join(f'{split}: {count} tables' for split, count in COUNTS.items())}")
