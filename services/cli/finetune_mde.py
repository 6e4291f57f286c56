"""``frugal finetune mde``."""

import json
import time
from pathlib import Path
from typing import TYPE_CHECKING, Literal

import click

from common.domain.model import PredictiveModel
from services.cli.asking import say
from services.cli.progress import bars

if TYPE_CHECKING:
    from pipelines.mde.trials import Trials
    from services.mde.ensemble import Calibrated

MODEL = click.option(
    "--model", required=True, help="heuristic, learned, simulator, or FILE.py:CLASS, a model of yours."
)
WEIGHTS = click.option(
    "--weights", type=click.Path(path_type=Path), help="Weights of the learned model [default: the released ones]."
)
BASE = click.option(
    "--base",
    type=click.Path(path_type=Path),
    help="Weights of the MDE to begin with [default: the released mde_<model>; for the simulator mde_learned].",
)
SEED = click.option("--seed", type=click.IntRange(0, 2**31), default=0, show_default=True)


@click.command()
@MODEL
@click.option(
    "--trials", "folder", type=click.Path(path_type=Path), required=True, help="Folder of the trials' case files."
)
@click.option(
    "--method",
    type=click.Choice(["last", "full", "scratch", "calibration"]),
    default="last",
    show_default=True,
    help="Train the last layers (the paper's), all weights, new networks on the trials alone, or a shift and a scale.",
)
@click.option("--iterations", type=click.IntRange(1, 100_000), default=500, show_default=True)
@SEED
@BASE
@WEIGHTS
@click.option("--version", help="Version of the new weights [default: <base's>-s2r-<digits of their content>].")
@click.option("--out", type=click.Path(path_type=Path), required=True, help="Folder of the new weights.")
@click.option("--json", "as_json", is_flag=True, help="All figures as JSON on standard output.")
def mde(
    *,
    model: str,
    folder: Path,
    method: Literal["last", "full", "scratch", "calibration"],
    iterations: int,
    seed: int,
    base: Path | None,
    weights: Path | None,
    version: str | None,
    out: Path,
    as_json: bool,
) -> None:
    """Fine-tune the MDE of a model on real trials: from how far it is from the simulator to how far from the world.

    Prints the mean absolute error on the trials before and, by cross-validation, after.
    """
    from pipelines.mde.finetune import FinetuneSettings, release_finetuned

    began, found = time.perf_counter(), find_model(model, weights)
    start = find_base(found.name, base)
    trials = predict_trials(folder, found)
    settings = FinetuneSettings(
        method=method,
        iterations=iterations,
        seed=seed,
        coverage=float(start.card.settings["coverage"]),
    )
    tuning = time.perf_counter()
    card = release_finetuned(start, trials, out, settings, version=version)
    before, after, seconds = card.metrics["before"], card.metrics["held_out"], time.perf_counter() - began
    if as_json:
        figures = {"folder": str(out), "version": card.version, "sha256": card.sha256, "left_out": trials.left_out}
        times = {"seconds": seconds, "finetuning_s": time.perf_counter() - tuning}
        settings_told = card.settings["finetuning"]
        click.echo(json.dumps({**figures, **times, "finetuning": settings_told, "metrics": card.metrics}, indent=2))
    say(
        f"{out}: {card.version}: MAE {before['mae']:.3f} before, {after['mae']:.3f} after, cross-validated on "
        f"{after['samples']} of {len(trials)} trials, the bound holds for {after['coverage']:.0%}; {seconds:.0f} s"
    )


def find_model(name: str, weights: Path | None) -> PredictiveModel:
    """Return a model as it is served, the simulator among them."""
    from services.cli import train_mde

    if name == "simulator":
        from services.simulator.model import SimulatorModel

        return SimulatorModel()
    if name == "learned" and weights is not None:
        from services.learned.load import load_learned

        return load_learned(weights)
    return train_mde.find_served(name)


def find_base(model: str, folder: Path | None) -> "Calibrated":
    """Return the MDE to begin with: the model's own, for the trusted model any."""
    from common.learning.weights import read_card
    from pipelines.mde.finetune import TRUSTED
    from services.cli.released import released
    from services.mde.ensemble import load_ensemble

    if model != TRUSTED:
        return load_ensemble(folder or released(f"mde_{model}"), model=model)
    folder = folder or released("mde_learned")
    return load_ensemble(folder, model=read_card(folder).name.removeprefix("mde_"))


def predict_trials(folder: Path, model: PredictiveModel) -> "Trials":
    """Return the trials of a folder with a model's deviations; says which ones it fails on."""
    from common.storage.cases import read_cases
    from pipelines.mde.trials import Trials

    cases = read_cases(folder)
    with bars() as progress:
        row = progress.add_task(f"predictions of {model.name}", total=len(cases))
        trials = Trials.predicted(
            folder.resolve().name, cases, model, report=lambda done: progress.update(row, completed=done)
        )
    if trials.left_out:
        say(f"left out {len(trials.left_out)} of {len(cases)} trials, the first: {trials.left_out[0]}")
    return trials
