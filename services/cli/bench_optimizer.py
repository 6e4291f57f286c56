"""``frugal bench optimizer``."""

import json
from collections.abc import Mapping

import click

from services.cli.progress import bars

ROWS = {
    "overhead": "optimize, all of a step but the model",
    "planner": "its planner: ask and tell",
    "sklearn": "scikit-learn's regressor in the planner",
    "botorch": "BoTorch, expected improvement",
    "botorch_ucb": "BoTorch, upper confidence bound",
}


@click.command()
@click.option("--seeds", type=click.IntRange(1, 1000), default=5, show_default=True, help="Runs of each loop.")
@click.option("--json", "as_json", is_flag=True, help="The figures as JSON on standard output.")
def optimizer(*, seeds: int, as_json: bool) -> None:
    """Measure what a step costs at 50 points, beside the same loop with scikit-learn's and BoTorch's models.

    All loops take turns in one process on one thread; on a machine that computes something else as well wall times are
    upper bounds, and processor times, which the ratios are of, stand beside them. scikit-learn and BoTorch are
    installed by the extra "bench".
    """
    from pipelines.bench.optimizer import bench_optimizer

    with bars() as progress:
        row = progress.add_task("steps", total=None)
        figures = bench_optimizer(
            seeds=seeds, report=lambda done, total: progress.update(row, completed=done, total=total)
        )
    if as_json:
        click.echo(json.dumps(figures, indent=2))
    else:
        show(figures)


def show(figures: Mapping[str, float]) -> None:
    """Print the figures for people."""
    from rich import box
    from rich.console import Console
    from rich.table import Table

    names = ("one step at 50 points", "wall ms", "processor ms", "times ours")
    drawn = Table(*names, box=box.SIMPLE_HEAD, pad_edge=False)
    for name, text in ROWS.items():
        wall, processor = figures[f"{name}_ms_at_50"], figures[f"{name}_processor_ms_at_50"]
        ratio = processor / figures["overhead_processor_ms_at_50"]
        drawn.add_row(text, f"{wall:.1f}", f"{processor:.1f}", f"{ratio:.1f}")
    Console().print(drawn)
