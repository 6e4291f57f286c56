"""``frugal train learned``."""

import time
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

import click

from services.cli.asking import say
from services.cli.progress import bars
from services.cli.train_mde import DATA

if TYPE_CHECKING:
    from common.learning.training import Epoch


@click.command()
@DATA
@click.option(
    "--out",
    type=click.Path(path_type=Path),
    default=Path("models/learned"),
    show_default=True,
    help="Folder of weights, card and cross-fitted deviations.",
)
@click.option("--seed", type=click.IntRange(0, 2**31), default=0, show_default=True)
@click.option("--epochs", type=click.IntRange(1, 10_000), help="Most passes over the data [default: see the card].")
@click.option("--threads", type=click.IntRange(1, 256), default=2, show_default=True)
@click.option(
    "--folds",
    type=click.IntRange(0, 20),
    default=2,
    show_default=True,
    help="Further networks, each blind to one fold, for the MDE's training data; 0: none.",
)
@click.option(
    "--variant",
    type=click.Choice(["window", "paper"]),
    default="window",
    show_default=True,
    help="Our network, or the paper's encoder-decoder that is told the action as numbers.",
)
def learned(*, data: Path, out: Path, variant: str, seed: int, epochs: int | None, threads: int, folds: int) -> None:
    """Train the learned model on a data set, measure it on the test samples, and cross-fit it for its MDE.

    The same data, seed, settings and number of threads give the same weights on the same machine.
    """
    from common.storage.dataset import Dataset
    from pipelines.train.learned import PAPER, LearnedSettings, release

    if folds == 1:
        raise click.UsageError("expected 0 or at least 2 folds, got 1")
    began, dataset, settings = (
        time.perf_counter(),
        Dataset.open(data),
        PAPER if variant == "paper" else LearnedSettings(),
    )
    training = replace(settings.training, seed=seed, threads=threads)
    if epochs is not None:
        training = replace(training, epochs=epochs)
    settings = replace(settings, training=training, folds=folds)
    with bars() as progress:
        rows = [
            progress.add_task("released" if number == 0 else f"fold {number}", total=training.epochs, start=False)
            for number in range(folds + 1)
        ]

        def report(number: int, epoch: "Epoch") -> None:
            progress.start_task(rows[number])
            progress.update(rows[number], completed=epoch.number)

        card = release(dataset, out, settings, report=report)
    figures = card.metrics
    say(
        f"{out}: RMSE {1e3 * figures['test_rmse_m']:.3f} mm on {figures['test_samples']} test samples, "
        f"heuristic {1e3 * figures['heuristic_test_rmse_m']:.3f} mm; {time.perf_counter() - began:.0f} s"
    )
