"""``frugal evaluate threshold``."""

import json
from functools import cache
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from services.cli.asking import say
from services.cli.progress import bars
from services.cli.train_mde import DATA

if TYPE_CHECKING:
    from pipelines.evaluate.threshold import Equipment, Plan


@click.command()
@DATA
@click.option("--targets", type=click.IntRange(1, 100_000), default=60, show_default=True)
@click.option("--evaluations", type=click.IntRange(1, 5000), default=50, show_default=True)
@click.option("--seed", type=click.IntRange(0, 2**31), default=0, show_default=True)
@click.option("--workers", type=click.IntRange(1, 64), default=1, show_default=True, help="Processes.")
@click.option(
    "--out",
    type=click.Path(path_type=Path),
    default=Path("out/threshold/trials.jsonl"),
    show_default=True,
    help="Raw results; a file that is there is gone on with.",
)
@click.option("--json", "as_json", is_flag=True, help="All figures as JSON on standard output.")
def threshold(*, data: Path, targets: int, evaluations: int, seed: int, workers: int, out: Path, as_json: bool) -> None:
    """Optimise held-out targets with all models and thresholds of 0.2, 0.3 and 0.4, and with the simulator alone.

    Beside each threshold stands the simulator alone, stopped at as many calls.
    """
    from common.storage.dataset import Dataset
    from pipelines.evaluate.threshold import Plan, read_records, run
    from pipelines.evaluate.threshold_table import threshold_table

    dataset, plan = Dataset.open(data), Plan(targets=targets, seed=seed, evaluations=evaluations)
    states = len(set(dataset.samples("test").groups.tolist()))
    if targets > states:
        raise click.UsageError(f"expected at most {states} targets, one for each test state, got {targets}")
    with bars() as progress:
        row = progress.add_task("targets", total=targets)
        run(
            out,
            plan,
            describe(dataset.card.name, dataset.card.version),
            Work(data, plan),
            workers=workers,
            report=lambda done: progress.update(row, completed=done),
        )
    table = threshold_table(read_records(out)[1])
    if as_json:
        click.echo(json.dumps(table, indent=2))
    else:
        show(table)
    say(f"written: {out}")


class Work:
    """Runs one target; what is loaded stays with its process."""

    def __init__(self, data: Path, plan: "Plan") -> None:
        self._data = data
        self._plan = plan

    def __call__(self, index: int, done: set[str]) -> list[dict[str, Any]]:
        """Return the records of a target's methods that are not done."""
        from pipelines.evaluate.targets import held_out_target
        from pipelines.evaluate.threshold import TRUSTED, run_target

        dataset, samples = _load(self._data)
        tools = equipment()
        case = held_out_target(dataset, samples, index, seed=self._plan.seed, simulator=tools.models[TRUSTED])
        return list(run_target(case, index, self._plan, tools, done))


@cache
def _load(data: Path) -> Any:
    from common.storage.dataset import Dataset

    dataset = Dataset.open(data)
    return dataset, dataset.samples("test")


@cache
def equipment() -> "Equipment":
    """Return heuristic, learned, simulator and both MDEs, all in this process on one thread."""
    from pipelines.evaluate.threshold import Equipment
    from services.cli.released import released
    from services.cli.train_mde import find_served
    from services.mde.estimator import read_estimator
    from services.simulator.model import SimulatorModel

    simulator = SimulatorModel()
    simulator.warm()
    return Equipment(
        models={"heuristic": find_served("heuristic"), "learned": find_served("learned"), "simulator": simulator},
        estimators={
            name: read_estimator(released(f"mde_{name}"), model=name, threads=1) for name in ("heuristic", "learned")
        },
    )


def describe(dataset: str, version: str) -> dict[str, Any]:
    """Return what the results rest on: data set, versions and weights."""
    from common.learning.weights import read_card
    from services.cli.released import released
    from services.simulator.model import SimulatorModel

    weights = {name: read_card(released(name)).sha256 for name in ("learned", "mde_heuristic", "mde_learned")}
    return {"dataset": dataset, "dataset_version": version, "simulator": SimulatorModel.version, "weights": weights}


def show(table: dict[str, dict[str, Any]]) -> None:
    """Print the table for people: lengths in mm."""
    from rich import box
    from rich.console import Console
    from rich.table import Table

    names = (
        "method",
        "targets",
        "action error mm",
        "true reward mm",
        "regret same",
        "regret other",
        "calls",
        "s",
        "ratio",
    )
    drawn = Table(*names, "shares", box=box.SIMPLE_HEAD, pad_edge=False)
    for method, figures in table.items():
        spreads = [
            "-" if figures[name] is None else "/".join(f"{1e3 * value:.2f}" for value in figures[name].values())
            for name in ("action_error_m", "true_reward_m", "regret_same_item_m", "regret_other_item_m")
        ]
        shares = ", ".join(f"{model} {share:.0%}" for model, share in figures["shares"].items())
        ratio = "-" if figures["time_ratio"] is None else f"{figures['time_ratio']:.3f}"
        calls, wall_s = f"{figures['simulator_calls']:.1f}", f"{figures['wall_s']:.2f}"
        drawn.add_row(method, str(figures["targets"]), *spreads, calls, wall_s, ratio, shares)
    Console(width=170).print(drawn)
    say("spreads are mean/median/p90, of rewards p10")
