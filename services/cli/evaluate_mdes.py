"""``frugal evaluate mdes``."""

import json
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from services.cli.asking import say
from services.cli.progress import bars
from services.cli.train_mde import COVERAGE, DATA, find_deviations

if TYPE_CHECKING:
    from rich.progress import Progress

    from common.storage.dataset import Dataset
    from pipelines.mde.subject import Subject
    from pipelines.mde.train import EnsembleSettings

COLUMNS = ("mae", "mae_std", "median_baseline_mae", "spearman", "auroc", "false_accept_rate", "bad_share", "recall")
"""What the table for people shows, besides coverage and d_max."""


@click.command()
@DATA
@click.option("--model", "models", multiple=True, default=("heuristic", "learned"), show_default=True)
@click.option("--variant", "variants", multiple=True, default=("paper", "crop"), show_default=True)
@click.option("--seeds", type=click.IntRange(1, 100), default=3, show_default=True, help="Trainings of each network.")
@click.option("--epochs", type=click.IntRange(1, 10_000), help="Passes over the data [default: the variant's].")
@COVERAGE
@click.option(
    "--out", type=click.Path(path_type=Path), default=Path("out/mdes"), show_default=True, help="Weights and results."
)
@click.option("--maps", type=click.IntRange(0, 50), default=0, show_default=True, help="Scenes to draw accept maps of.")
@click.option(
    "--map-actions", type=click.IntRange(3, 100), default=15, show_default=True, help="Actions along x and y."
)
@click.option("--released", "as_released", is_flag=True, help="Judge the released weights alone; nothing is trained.")
@click.option("--json", "as_json", is_flag=True, help="All figures as JSON on standard output.")
def mdes(
    *,
    data: Path,
    models: tuple[str, ...],
    variants: tuple[str, ...],
    seeds: int,
    epochs: int | None,
    coverage: float,
    out: Path,
    maps: int,
    map_actions: int,
    as_released: bool,
    as_json: bool,
) -> None:
    """Measure the MDEs on the test samples: Table II, first row, with what accepting by them leads to.

    Networks that are not there yet are trained; raw results and the reliability plot are written to --out. Accept maps
    ask the simulator about every action of a grid.
    """
    from common.storage.dataset import Dataset
    from pipelines.evaluate.mdes import mdes_table
    from pipelines.evaluate.mdes_figures import draw_reliability
    from pipelines.evaluate.mdes_runs import Run, judge, write_runs
    from pipelines.figures import save_figure
    from pipelines.mde.examples import deviation_scale
    from pipelines.mde.train import default_settings
    from services.cli.released import released

    dataset = Dataset.open(data)
    scale_m = 0.0 if as_released else deviation_scale(dataset)
    runs: list[Run] = []
    chosen: dict[str, Path] = {}
    with bars() as progress:
        for name in models:
            subject = find_deviations(dataset, name, None, progress)
            if as_released:
                runs.append(judge(dataset, subject, chosen.setdefault(subject.name, released(f"mde_{subject.name}"))))
                continue
            for variant in variants:
                for seed in range(seeds):
                    settings = default_settings(variant, seed=seed, epochs=epochs, coverage=coverage)
                    folder = find_or_train(dataset, subject, settings, scale_m, out, progress)
                    runs.append(judge(dataset, subject, folder))
                    if variant != "paper" and seed == 0:
                        chosen[subject.name] = folder
                    chosen.setdefault(subject.name, folder)
        write_runs(out / "judgements.jsonl", runs)
        table = mdes_table(runs)
        if maps:
            draw_maps(dataset, chosen, out, scenes=maps, count=map_actions, progress=progress)
    save_figure(draw_reliability(runs), out / "reliability")
    (out / "mdes.json").write_text(json.dumps(table, indent=2) + "\n")
    if as_json:
        click.echo(json.dumps(table, indent=2))
    else:
        show(table)
    say(f"written: {out / 'judgements.jsonl'}, {out / 'mdes.json'}, {out / 'reliability.png'}")


def find_or_train(
    dataset: "Dataset",
    subject: "Subject",
    settings: "EnsembleSettings",
    scale_m: float,
    work: Path,
    progress: "Progress",
) -> Path:
    """Return the folder of weights with these settings; they are trained where there are none."""
    from pipelines.evaluate.mdes_runs import find_weights
    from services.cli.released import released

    epochs = settings.members * settings.training.epochs
    row = progress.add_task(f"{subject.name} {settings.variant} {settings.training.seed}", total=epochs)
    folder = find_weights(
        dataset,
        subject,
        settings,
        scale_m=scale_m,
        released=released(f"mde_{subject.name}"),
        work=work,
        report=lambda member, epoch: progress.advance(row),
    )
    progress.update(row, completed=epochs)
    return folder


def draw_maps(
    dataset: "Dataset", chosen: dict[str, Path], out: Path, *, scenes: int, count: int, progress: "Progress"
) -> None:
    """Write accept maps of the first test states, raw and drawn."""
    from common.learning.weights import read_card
    from common.tasks import TASKS
    from pipelines.evaluate.accept_maps import accept_maps, write_map
    from pipelines.evaluate.mdes_figures import draw_accept_maps
    from pipelines.figures import save_figure
    from services.cli.train_mde import find_served
    from services.mde.estimator import read_estimator
    from services.simulator.model import SimulatorModel

    models = {name: find_served(name) for name in chosen}
    cards = {name: read_card(folder) for name, folder in chosen.items()}
    estimators = {
        name: (read_estimator(folder, model=name), cards[name].deviation_scale_m or 1.0, cards[name].metrics["d_max"])
        for name, folder in chosen.items()
    }
    simulator = SimulatorModel()
    for scene in range(scenes):
        row = progress.add_task(f"accept maps of scene {scene}", total=count**2)
        drawn = accept_maps(
            dataset.state("test", scene),
            TASKS["plating"],
            simulator,
            models,
            estimators,
            count=count,
            report=lambda done, row=row: progress.update(row, completed=done),
        )
        for one in drawn:
            write_map(out / "maps" / f"{scene:03d}-{one.model}.npz", one)
        save_figure(draw_accept_maps(drawn), out / "maps" / f"{scene:03d}")


def show(table: dict[str, dict[str, dict[str, Any]]]) -> None:
    """Print the table for people."""
    from rich import box
    from rich.console import Console
    from rich.table import Table

    drawn = Table("model", "variant", *COLUMNS, "coverage", "d_max", "ms", box=box.SIMPLE_HEAD, pad_edge=False)
    for model, variants in table.items():
        for variant, figures in variants.items():
            cells = ["-" if figures[name] is None else f"{figures[name]:.3f}" for name in (*COLUMNS, "coverage")]
            drawn.add_row(model, variant, *cells, f"{figures['d_max']:g}", f"{1e3 * figures['action_s']:.2f}")
    Console(width=150).print(drawn)
