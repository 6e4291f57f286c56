"""``frugal evaluate strategies``."""

import json
from collections.abc import Sequence
from functools import cache
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from common.domain.errors import RequestError
from common.domain.model import PredictiveModel
from services.cli.asking import say
from services.cli.progress import bars

if TYPE_CHECKING:
    from pipelines.evaluate.strategies import Comparison, Kit
    from services.mde.estimator import NetworkEstimator

LEVELS = ("simulator_coarse", "simulator", "simulator_fine")
"""Names of the simulator's levels, from cheapest to dearest."""
SETS = ("main", "mdes", "d_max", "calls", "botorch", "fidelities", "in-flight")


@click.command()
@click.option("--targets", type=click.IntRange(2, 100_000), default=24, show_default=True)
@click.option("--split", type=click.Choice(["development", "held-out"]), default="development", show_default=True)
@click.option("--set", "sets", type=click.Choice(SETS), multiple=True, help="Strategies that belong together [main].")
@click.option(
    "--strategy",
    "strategies",
    multiple=True,
    help="A strategy, also with +constant-mde, +oracle-mde, +d_max=0.2, +2-in-flight; also botorch:ucb, botorch:logei, "
    "botorch:mfkg:calls=6, polish:calls=6.",
)
@click.option("--evaluations", type=click.IntRange(1, 5000), default=50, show_default=True)
@click.option("--in-flight", type=click.IntRange(1, 64), default=1, show_default=True, help="Evaluations at a time.")
@click.option("--seed", type=click.IntRange(0, 2**31), default=0, show_default=True)
@click.option("--trusted", type=click.Choice(LEVELS[1:]), default="simulator", show_default=True)
@click.option(
    "--model",
    "models",
    multiple=True,
    help="A member of the family besides the trusted one, from cheapest to dearest [heuristic, learned if released, "
    "and with --trusted simulator_fine the default level].",
)
@click.option(
    "--jitter", type=click.IntRange(0, 1000), default=4, show_default=True, help="Execution errors tried on an answer."
)
@click.option("--workers", type=click.IntRange(1, 64), default=1, show_default=True, help="Targets at the same time.")
@click.option(
    "--out", type=click.Path(path_type=Path), default=Path("out/strategies"), show_default=True, help="Raw results."
)
@click.option("--json", "as_json", is_flag=True, help="All figures as JSON on standard output.")
def strategies(
    *,
    targets: int,
    split: str,
    sets: tuple[str, ...],
    strategies: tuple[str, ...],
    evaluations: int,
    in_flight: int,
    seed: int,
    trusted: str,
    models: tuple[str, ...],
    jitter: int,
    workers: int,
    out: Path,
    as_json: bool,
) -> None:
    """Compare strategies with the simulator alone on the same targets, half of them made with another item.

    Models run in this process, or in --workers; the learned model and the MDEs take part where their weights are
    released. Raw results, the table and its figures are written to --out; a run that was interrupted is gone on with.
    """
    from pipelines.evaluate.strategies import find_targets, make_plan
    from pipelines.evaluate.strategies_figures import draw_pareto, draw_sweeps
    from pipelines.evaluate.strategies_methods import SETS
    from pipelines.evaluate.strategies_table import strategies_table
    from pipelines.evaluate.threshold import read_records, run
    from pipelines.figures import save_figure
    from services.simulator.settle import settle_boxes

    chosen = [*strategies, *(name for each in sets for name in SETS[each](trusted))] or SETS["main"](trusted)
    plan = make_plan(
        targets,
        chosen,
        evaluations=evaluations,
        seed=seed,
        trusted=trusted,
        jitter=jitter,
        in_flight=in_flight,
    )
    family, path = (*(models or default_family(trusted)), trusted), out / f"{split}.jsonl"
    if any(method.control for method in plan.methods) and not any(map(is_estimated, family)):
        raise RequestError("constant-mde, oracle-mde: expected an MDE to replace, got none with released weights")
    folder = out / "targets" / (split if trusted == "simulator" else f"{split}-{trusted}")
    with bars() as progress:
        row = progress.add_task("targets", total=targets)
        files = find_targets(targets, split, folder, settle=settle_boxes, simulator=find_member(trusted))
        run(
            path,
            plan,
            {"split": split, "family": list(family), **versions(family)},
            Work(files, plan, family),
            workers=workers,
            report=lambda done: progress.update(row, completed=done),
        )
    table = strategies_table(read_records(path)[1], trusted=trusted)
    if not table:
        raise RequestError(f"{path}: expected a target that every method has done, got none; see its errors")
    path.with_suffix(".json").write_text(json.dumps(table, indent=2) + "\n")
    save_figure(draw_pareto(table), out / f"{split}-pareto")
    save_figure(draw_sweeps(table), out / f"{split}-sweeps")
    if as_json:
        click.echo(json.dumps(table, indent=2))
    else:
        show(table)
    say(f"written: {path}, {path.with_suffix('.json').name}, {split}-pareto.png, {split}-sweeps.png")


class Work:
    """Runs one target; what is loaded stays with its process."""

    def __init__(self, files: Sequence[Path], plan: "Comparison", family: tuple[str, ...]) -> None:
        self._files = files
        self._plan = plan
        self._family = family

    def __call__(self, index: int, done: set[str]) -> list[dict[str, Any]]:
        """Return the records of a target's methods that are not done."""
        from common.storage.cases import read_case
        from pipelines.evaluate.strategies import run_strategies

        return list(run_strategies(read_case(self._files[index]), index, self._plan, kit(self._family), done))


@cache
def kit(family: tuple[str, ...]) -> "Kit":
    """Return models and MDEs of a family, the trusted one last, all in this process on one thread."""
    from pipelines.evaluate.family import make_kit

    return make_kit(family, released_weights(family), find=find_member)


def released_weights(family: Sequence[str]) -> dict[str, Path]:
    """Return the folders of the released weights of models and their MDEs, by name."""
    from services.cli.released import is_released, released

    names = [name for member in family for name in (member, f"mde_{member}")]
    return {name: released(name) for name in names if is_released(name)}


def default_family(trusted: str) -> list[str]:
    """Return the models that are cheaper than the trusted one, from cheapest to dearest."""
    from services.cli.released import is_released

    levels = LEVELS[1 : LEVELS.index(trusted)]
    return ["heuristic", *(["learned"] if is_released("learned") else []), *levels]


def find_member(name: str) -> PredictiveModel:
    """Return a model by name or as ``FILE.py:CLASS``, a level of the simulator with its kernels compiled."""
    from pipelines.evaluate import family
    from services.cli.train_mde import find_model

    return find_model(name) if ":" in name else family.find_member(name, released_weights([name]))


def is_estimated(name: str) -> bool:
    """Return whether the MDE of a model is released."""
    from services.cli.released import is_released

    return is_released(f"mde_{name}")


def find_estimator(name: str) -> "NetworkEstimator":
    """Return the released MDE of a model."""
    from pipelines.evaluate import family

    return family.find_estimator(name, released_weights([name]))


def versions(family: Sequence[str]) -> dict[str, Any]:
    """Return the versions of models and MDEs, with their weights."""
    from pipelines.evaluate.family import versions

    return versions(released_weights(family))


def show(table: Sequence[dict[str, Any]]) -> None:
    """Print the table for people: lengths in mm and um, ratios to the reference with their upper bound."""
    from rich import box
    from rich.console import Console
    from rich.table import Table

    names = ("strategy", "error mean mm", "median mm", "ratio of means", "of medians", "regret um", "other item um")
    drawn = Table(*names, "jitter um", "calls", "s", "ratio", "cpu", box=box.SIMPLE_HEAD, pad_edge=False)
    for row in table:
        drawn.add_row(
            row["strategy"],
            *(_interval(row[figure], 1e3) for figure in ("error_mean_m", "error_median_m")),
            *(_ratio(row[figure]) for figure in ("error_mean_m", "error_median_m")),
            *(_interval(row[figure], 1e6, digits=0) for figure in ("reward_regret_m", "reward_regret_other_m")),
            _number(row["jitter_reward_m"]["difference"], 1e6, digits=0),
            _number(row["simulator_calls"]["value"], 1.0, digits=1),
            _number(row["wall_s"]["value"], 1.0, digits=2),
            _number(row["wall_s"]["ratio"], 1.0, digits=3),
            _number(row["processor_s"]["ratio"], 1.0, digits=3),
        )
    Console(width=190).print(drawn)
    failed = sum(row["failed"] for row in table)
    say(
        f"{table[0]['targets']} targets, {failed} failures; 95% intervals in brackets; jitter: expected reward under "
        "execution errors, minus the reference's; s: wall time and its ratio; cpu: ratio of processor time"
    )


def _number(value: float | None, scale: float, *, digits: int) -> str:
    return "-" if value is None else f"{scale * value:.{digits}f}"


def _interval(figure: dict[str, float | None], scale: float, *, digits: int = 2) -> str:
    value, low, high = (_number(figure[name], scale, digits=digits) for name in ("value", "low", "high"))
    return f"{value} [{low}, {high}]"


def _ratio(figure: dict[str, float | None]) -> str:
    value, high = (_number(figure[name], 1.0, digits=2) for name in ("ratio", "ratio_high"))
    return f"{value} (<{high})"
