"""``frugal evaluate certificate``."""

import json
from collections.abc import Sequence
from functools import cache
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from services.cli.asking import say
from services.cli.progress import bars

if TYPE_CHECKING:
    from pipelines.evaluate.threshold import Equipment


@click.command()
@click.option("--targets", type=click.IntRange(1, 100_000), default=24, show_default=True)
@click.option("--split", type=click.Choice(["development", "held-out"]), default="development", show_default=True)
@click.option("--calls", type=click.IntRange(1, 64), default=12, show_default=True, help="Simulator calls of a target.")
@click.option("--workers", type=click.IntRange(1, 64), default=1, show_default=True, help="Processes.")
@click.option(
    "--out", type=click.Path(path_type=Path), default=Path("out/certificate"), show_default=True, help="Raw results."
)
@click.option("--json", "as_json", is_flag=True, help="All figures as JSON on standard output.")
def certificate(*, targets: int, split: str, calls: int, workers: int, out: Path, as_json: bool) -> None:
    """Measure for which share of the targets the certificate was wrong, and how large a gain it allowed.

    Every target is optimised without stopping early, and all actions that its certificate is about are simulated. The
    factors that development targets need are those of `common.planning.certificate`. Raw results are kept in --out, and
    a run that was interrupted is gone on with.
    """
    from pipelines.evaluate.certificate import METHOD, certificate_table
    from pipelines.evaluate.strategies import find_targets
    from pipelines.evaluate.threshold import TRUSTED, Method, Plan, read_records, run
    from services.cli.evaluate_strategies import default_family, find_member, versions
    from services.simulator.settle import settle_boxes

    plan = Plan(targets, evaluations=calls, methods=(Method(METHOD),))
    family, path = (*default_family(TRUSTED), TRUSTED), out / f"{split}-{calls}.jsonl"
    with bars() as progress:
        row = progress.add_task("targets", total=targets)
        folder = out / "targets" / split
        files = find_targets(targets, split, folder, settle=settle_boxes, simulator=find_member(TRUSTED))
        run(
            path,
            plan,
            {"split": split, **versions(family)},
            Work(files, family, calls),
            workers=workers,
            report=lambda done: progress.update(row, completed=done),
        )
    table = certificate_table(read_records(path)[1], [count for count in (1, 3, 6, 12) if count < calls] + [calls])
    if as_json:
        click.echo(json.dumps(table, indent=2))
    else:
        show(table)
    say(f"written: {path}")


class Work:
    """Runs one target; what is loaded stays with its process."""

    def __init__(self, files: Sequence[Path], family: tuple[str, ...], calls: int) -> None:
        self._files = files
        self._family = family
        self._calls = calls

    def __call__(self, index: int, done: set[str]) -> list[dict[str, Any]]:
        """Return the record of a target."""
        from common.storage.cases import read_case
        from pipelines.evaluate.certificate import run_certificate

        return [run_certificate(read_case(self._files[index]), index, equipment(self._family), calls=self._calls)]


@cache
def equipment(family: tuple[str, ...]) -> "Equipment":
    """Return models and MDEs of a family, all in this process on one thread."""
    from pipelines.evaluate.threshold import Equipment
    from services.cli.evaluate_strategies import find_estimator, find_member, is_estimated

    estimators = {name: find_estimator(name) for name in family[:-1] if is_estimated(name)}
    return Equipment({name: find_member(name) for name in family}, estimators)


def show(table: dict[str, Any]) -> None:
    """Print the table for people, in micrometres of mean height."""
    for row in table["rows"]:
        constant = row["constant_gain_m"]
        click.echo(
            f"{row['calls']:3d} calls: violated {row['violated']:.3f}, stated gain {1e6 * row['gain_median_m']:.0f} um "
            f"(mean {1e6 * row['gain_mean_m']:.0f}), true {1e6 * row['true_gain_median_m']:.0f}, "
            f"a constant {'-' if constant is None else f'{1e6 * constant:.0f}'}, places left {row['left']:.2f}"
        )
    if table["anywhere"] is not None:
        click.echo(f"violated after any of the calls: {table['anywhere']:.3f}, stated {1 - table['probability']:.3f}")
    click.echo(f"{table['certified']} of {table['targets']} targets have a certificate")
    for model, factor in table["factors_needed"].items():
        used = table["factors_used"].get(model)
        needed = "more targets than these" if factor is None else f"{factor:.2f}"
        click.echo(
            f"factor of {model}: {'none' if used is None else f'{used:.2f}'} is used, these targets need {needed}"
        )
