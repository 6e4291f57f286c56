"""``frugal train mde``."""

import time
from pathlib import Path
from typing import TYPE_CHECKING

import click

from common.domain.errors import RequestError
from common.domain.model import PredictiveModel
from services.cli.asking import say
from services.cli.progress import bars

if TYPE_CHECKING:
    from rich.progress import Progress

    from common.storage.dataset import Dataset
    from pipelines.mde.subject import Subject

COVERAGE = click.option(
    "--coverage",
    type=click.FloatRange(0, 1, min_open=True, max_open=True),
    default=0.9,
    show_default=True,
    help="Share of new samples for which the upper bound is to hold.",
)
DATA = click.option(
    "--data", type=click.Path(path_type=Path), default=Path("data/sim-v1"), show_default=True, help="The data set."
)


@click.command()
@click.option(
    "--model", required=True, help="heuristic, learned, simulator_coarse, or FILE.py:CLASS, a model of yours."
)
@DATA
@click.option("--out", type=click.Path(path_type=Path), help="Folder of the weights [default: models/mde_<model>].")
@click.option("--variant", type=click.Choice(["crop", "paper"]), default="crop", show_default=True, help="The network.")
@click.option("--seed", type=click.IntRange(0, 2**31), default=0, show_default=True)
@click.option("--epochs", type=click.IntRange(1, 10_000), help="Passes over the data [default: the variant's].")
@COVERAGE
@click.option(
    "--deviations",
    type=click.Path(path_type=Path),
    help="File with the model's deviations from the training outcomes, of a model that was trained on the same data "
    "[default for learned: deviations.npz beside its weights].",
)
def mde(
    *,
    model: str,
    data: Path,
    out: Path | None,
    variant: str,
    seed: int,
    epochs: int | None,
    coverage: float,
    deviations: Path | None,
) -> None:
    """Train the MDE of a model: how far it is from the simulator, learned from a data set of simulated placements.

    The model predicts all training samples first; one that was itself trained on them brings its cross-fitted
    deviations instead.
    """
    from common.storage.dataset import Dataset
    from pipelines.mde.examples import deviation_scale
    from pipelines.mde.release import release
    from pipelines.mde.train import default_settings

    began, dataset = time.perf_counter(), Dataset.open(data)
    settings = default_settings(variant, seed=seed, epochs=epochs, coverage=coverage)
    with bars() as progress:
        subject = find_deviations(dataset, model, deviations, progress)
        folder = out or Path("models") / f"mde_{subject.name}"
        row = progress.add_task("epochs", total=settings.members * settings.training.epochs)
        card = release(
            dataset,
            subject.name,
            subject.train_m,
            folder,
            settings,
            model_version=subject.version,
            scale_m=deviation_scale(dataset),
            report=lambda member, epoch: progress.advance(row),
        )
    held_out = card.metrics["held_out"]
    say(
        f"{folder}: MAE {held_out['mae']:.3f} on states that a member did not see, always the median "
        f"{held_out['median_baseline_mae']:.3f}; {time.perf_counter() - began:.0f} s"
    )


def find_deviations(dataset: "Dataset", model: str, path: Path | None, progress: "Progress") -> "Subject":
    """Return a model with its deviations: those in a file, those that the learned model brings, or new ones."""
    from pipelines.mde.crossfit import OtherSamplesError, read_deviations
    from pipelines.mde.subject import Subject
    from services.cli.released import released

    if path is not None or model == "learned":
        try:
            crossfit = read_deviations(path or released(model) / "deviations.npz", dataset)
        except OtherSamplesError:
            if path is not None:
                raise
        else:
            return Subject(model, crossfit.version, crossfit.train_m, crossfit.test_m)
    found = find_served(model)
    row = progress.add_task(f"predictions of {found.name}", total=sum(dataset.card.counts.values()))
    return Subject.predicting(dataset, found, report=lambda done: progress.update(row, completed=done))


def find_model(name: str) -> PredictiveModel:
    """Return a model that needs no training data, by its name or as ``FILE.py:CLASS``."""
    from services.cli.serve import load_model

    if name == "heuristic":
        from services.heuristic import HeuristicModel

        return HeuristicModel()
    if name == "simulator_coarse":
        from services.simulator.model import SimulatorModel

        return SimulatorModel.at_level("coarse")
    if ":" not in name:
        raise RequestError(f"model: expected heuristic, learned, simulator_coarse or FILE.py:CLASS, got {name!r}")
    return load_model(name)


def find_served(name: str) -> PredictiveModel:
    """Return a model as it is served: also one with released weights."""
    if name != "learned":
        return find_model(name)
    from services.cli.released import released
    from services.learned.load import load_learned

    return load_learned(released("learned"))
