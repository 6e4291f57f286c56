"""``frugal report``."""

import json
from pathlib import Path

import click

from services.cli.asking import say
from services.cli.evaluate import EXPERIMENTS_FOLDER, RAW


@click.command()
@click.option(
    "--out", type=click.Path(path_type=Path), default=Path("docs"), show_default=True, help="results.md and figures/."
)
@RAW
@EXPERIMENTS_FOLDER
@click.option("--partial", is_flag=True, help="Write what there is; experiments without raw results are named.")
@click.option("--json", "as_json", is_flag=True, help="Every number as JSON on standard output.")
def report(*, out: Path, raw: Path, experiments: Path | None, partial: bool, as_json: bool) -> None:
    """Write the paper's tables and figures with ours beside them, from raw results alone."""
    from pipelines.experiments import report
    from pipelines.experiments.experiment import FOLDER, read_experiments

    sections = report.make_sections(read_experiments(experiments or FOLDER), raw, partial=partial)
    path = report.write_report(sections, out)
    if as_json:
        click.echo(json.dumps(report.as_json(sections), indent=2))
    for section in sections:
        if section.missing:
            say(f"left out: {section.missing}")
    say(f"written: {path}, {len(report.as_json(sections))} numbers")
