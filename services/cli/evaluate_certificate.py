"""``frugal evaluate certificate``."""

import json
from pathlib import Path
from typing import Any

import click

from services.cli.asking import say
from services.cli.progress import bars


@click.command()
@click.option("--targets", type=click.IntRange(1, 100_000), default=24, show_default=True)
@click.option("--split", type=click.Choice(["development", "held-out"]), default="development", show_default=True)
@click.option("--calls", type=click.IntRange(1, 64), default=12, show_default=True, help="Simulator calls of a target.")
@click.option(
    "--out", type=click.Path(path_type=Path), default=Path("out/certificate"), show_default=True, help="Raw results."
)
@click.option("--json", "as_json", is_flag=True, help="All figures as JSON on standard output.")
def certificate(*, targets: int, split: str, calls: int, out: Path, as_json: bool) -> None:
    """Measure for which share of the targets the certificate was wrong, and how large a gain it allowed.

    Every target is optimised without stopping early, and all actions that its certificate is about are simulated. The
    factors that development targets need are those of `common.planning.certificate`. Raw results are kept in --out, and
    a run that was interrupted is gone on with.
    """
    from pipelines.evaluate.certificate import METHOD, certificate_table, run_certificate
    from pipelines.evaluate.strategies import find_targets
    from pipelines.evaluate.threshold import Method, Plan, read_records, run
    from services.cli.evaluate_strategies import equipment, versions
    from services.simulator.settle import settle_boxes

    plan = Plan(targets, evaluations=calls, methods=(Method(METHOD),))
    tools, path = equipment(), out / f"{split}-{calls}.jsonl"
    with bars() as progress:
        row = progress.add_task("targets", total=targets)
        cases = find_targets(targets, split, out / "targets" / split, settle=settle_boxes, equipment=tools)
        run(
            path,
            plan,
            {"split": split, **versions(tools)},
            lambda index, done: [run_certificate(cases[index], index, tools, calls=calls)],
            report=lambda done: progress.update(row, completed=done),
        )
    table = certificate_table(read_records(path)[1], [count for count in (1, 3, 6, 12) if count < calls] + [calls])
    if as_json:
        click.echo(json.dumps(table, indent=2))
    else:
        show(table)
    say(f"written: {path}")


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
