"""``frugal evaluate strategies``."""

import json
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from services.cli.asking import say
from services.cli.progress import bars

if TYPE_CHECKING:
    from pipelines.evaluate.threshold import Equipment


@click.command()
@click.option("--targets", type=click.IntRange(2, 100_000), default=24, show_default=True)
@click.option("--split", type=click.Choice(["development", "held-out"]), default="development", show_default=True)
@click.option("--strategy", "strategies", multiple=True, help="A strategy, also with +constant-mde or +oracle-mde.")
@click.option("--evaluations", type=click.IntRange(1, 5000), default=50, show_default=True)
@click.option("--in-flight", type=click.IntRange(1, 64), default=1, show_default=True, help="Evaluations at a time.")
@click.option("--seed", type=click.IntRange(0, 2**31), default=0, show_default=True)
@click.option(
    "--out", type=click.Path(path_type=Path), default=Path("out/strategies"), show_default=True, help="Raw results."
)
@click.option("--json", "as_json", is_flag=True, help="All figures as JSON on standard output.")
def strategies(
    *,
    targets: int,
    split: str,
    strategies: tuple[str, ...],
    evaluations: int,
    in_flight: int,
    seed: int,
    out: Path,
    as_json: bool,
) -> None:
    """Compare strategies with the simulator alone on the same targets, half of them made with another item.

    Models run in this process; the learned model and the MDEs take part where their weights are released. Raw results
    are kept in --out, and a run that was interrupted is gone on with.
    """
    from pipelines.evaluate.strategies import STRATEGIES, find_targets, make_plan, run_strategies
    from pipelines.evaluate.strategies_table import strategies_table
    from pipelines.evaluate.threshold import read_records, run
    from services.simulator.settle import settle_boxes

    plan = make_plan(targets, strategies or STRATEGIES, evaluations=evaluations, seed=seed)
    tools, path = equipment(), out / f"{split}.jsonl"
    about = {"split": split, "in_flight": in_flight, **versions(tools)}
    with bars() as progress:
        row = progress.add_task("targets", total=targets)
        cases = find_targets(targets, split, out / "targets" / split, settle=settle_boxes, equipment=tools)
        run(
            path,
            plan,
            about,
            lambda index, done: list(run_strategies(cases[index], index, plan, tools, done, in_flight=in_flight)),
            report=lambda done: progress.update(row, completed=done),
        )
    table = strategies_table(read_records(path)[1])
    if as_json:
        click.echo(json.dumps(table, indent=2))
    else:
        show(table)
    say(f"written: {path}")


def equipment() -> "Equipment":
    """Return the models and MDEs that there are, all in this process."""
    from pipelines.evaluate.threshold import Equipment
    from services.cli.released import is_released, released
    from services.cli.train_mde import find_served
    from services.simulator.model import SimulatorModel

    simulator = SimulatorModel()
    simulator.warm()
    cheap = ["heuristic", *(["learned"] if is_released("learned") else [])]
    estimated = [name for name in cheap if is_released(f"mde_{name}")]
    estimators = {}
    if estimated:
        from services.mde.estimator import read_estimator

        estimators = {name: read_estimator(released(f"mde_{name}"), model=name, threads=1) for name in estimated}
    return Equipment({**{name: find_served(name) for name in cheap}, "simulator": simulator}, estimators)


def versions(tools: "Equipment") -> dict[str, Any]:
    """Return the versions of models and MDEs, with their weights."""
    models = {name: [model.version, getattr(model, "weights", None)] for name, model in tools.models.items()}
    mdes = {name: [mde.version, getattr(mde, "weights", None)] for name, mde in tools.estimators.items()}
    return {"models": models, "mdes": mdes}


def show(table: Sequence[dict[str, Any]]) -> None:
    """Print the table for people, in millimetres and seconds."""
    from rich import box
    from rich.console import Console
    from rich.table import Table

    names = (
        "strategy",
        "error mean mm",
        "error median mm",
        "regret um",
        "regret, other item um",
        "calls",
        "s",
        "ratio",
    )
    drawn = Table(*names, box=box.SIMPLE_HEAD, pad_edge=False)
    for row in table:
        drawn.add_row(
            row["strategy"],
            *(_interval(row[figure], 1e3) for figure in ("error_mean_m", "error_median_m")),
            *(_interval(row[figure], 1e6, digits=0) for figure in ("reward_regret_m", "reward_regret_other_m")),
            f"{row['simulator_calls']['value']:.1f}",
            f"{row['wall_s']['value']:.2f}",
            f"{row['time_ratio']['value']:.3f}",
        )
    Console(width=170).print(drawn)
    say(f"{table[0]['targets']} targets; 95% intervals in brackets")


def _interval(figure: dict[str, float], scale: float, *, digits: int = 2) -> str:
    value, low, high = (f"{scale * figure[name]:.{digits}f}" for name in ("value", "low", "high"))
    return f"{value} [{low}, {high}]"
