"""``frugal evaluate models``."""

import json
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from services.cli.asking import say
from services.cli.progress import bars
from services.cli.train_mde import DATA

if TYPE_CHECKING:
    from pipelines.evaluate.models_runs import Latency, Measurement


@click.command()
@DATA
@click.option("--learned", type=click.Path(path_type=Path), help="Folder of its weights [default: the released ones].")
@click.option(
    "--fine",
    type=click.IntRange(0, 100_000),
    default=20,
    show_default=True,
    help="Test samples on which the simulator is compared with its fine level; 0: none.",
)
@click.option("--states", type=click.IntRange(1, 100_000), default=40, show_default=True, help="States for the times.")
@click.option(
    "--out", type=click.Path(path_type=Path), default=Path("out/models"), show_default=True, help="Raw results."
)
@click.option("--json", "as_json", is_flag=True, help="All figures as JSON on standard output.")
def models(*, data: Path, learned: Path | None, fine: int, states: int, out: Path, as_json: bool) -> None:
    """Measure the models on the test samples: Table I, first row, by region and material too.

    The RMSE of a sample is over the whole grid; the table has its mean and spread over the samples. Heuristic and
    learned model are compared with the data set's outcomes, the simulator with its fine level.
    """
    from pipelines.evaluate.models import models_table
    from pipelines.evaluate.models_runs import write_rows

    rows = run(data, learned, fine=fine, states=states)
    write_rows(out / "measurements.jsonl", rows)
    table = models_table(rows)
    (out / "models.json").write_text(json.dumps(table, indent=2) + "\n")
    if as_json:
        click.echo(json.dumps(table, indent=2))
    else:
        show(table)
    say(f"written: {out / 'measurements.jsonl'}, {out / 'models.json'}")


def run(data: Path, learned: Path | None, *, fine: int, states: int) -> "list[Measurement | Latency]":
    """Return the raw results of all models."""
    from common.storage.dataset import Dataset
    from pipelines.evaluate.models_runs import measure, measure_pair, time_batches
    from services.cli.released import released
    from services.heuristic import HeuristicModel
    from services.learned.load import load_learned

    dataset = Dataset.open(data)
    samples = dataset.samples("test")
    rows: list[Measurement | Latency] = []
    with bars() as progress:
        for model in (HeuristicModel(), load_learned(learned or released("learned"))):
            row = progress.add_task(model.name, total=len(samples))
            rows += measure(model, dataset, samples, report=lambda done, row=row: progress.update(row, completed=done))
            rows.append(time_batches(model, dataset, samples, states=states))
        if fine:
            from services.simulator.model import SimulatorModel

            simulator, reference = SimulatorModel(), SimulatorModel.at_level("fine")
            row = progress.add_task("simulator against its fine level", total=fine)
            rows += measure_pair(
                simulator,
                reference,
                dataset,
                samples,
                count=fine,
                report=lambda done: progress.update(row, completed=done),
            )
    return rows


def show(table: dict[str, dict[str, Any]]) -> None:
    """Print the table for people, in millimetres and milliseconds."""
    from rich import box
    from rich.console import Console
    from rich.table import Table

    parts = list(next(iter(table.values()))["parts"])
    drawn = Table("model", "against", "n", "RMSE [mm]", "ratio", *parts, "p50 [ms]", "p95 [ms]", box=box.SIMPLE_HEAD)
    for model, figures in table.items():
        of_parts = [_spread(figures["parts"][part]) for part in parts]
        times = [f"{1e3 * figures[name]:.2f}" for name in ("latency_p50_s", "latency_p95_s")]
        ratio = "-" if figures["ratio"] is None else f"{figures['ratio']:.3f}"
        drawn.add_row(model, figures["reference"], str(figures["samples"]), _spread(figures), ratio, *of_parts, *times)
    Console(width=160).print(drawn)


def _spread(figures: dict[str, Any]) -> str:
    if figures["rmse_m"] is None:
        return "-"
    return f"{1e3 * figures['rmse_m']:.2f} ({1e3 * figures['rmse_std_m']:.2f})"
