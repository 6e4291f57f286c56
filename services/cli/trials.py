"""``frugal trials``: what robots executed and a recorder keeps."""

import json
from pathlib import Path

import click

from common.domain.errors import RequestError
from common.storage.trial_files import Record, RecordedTrial, find_trials
from common.tasks import TASKS
from services.cli.asking import say
from services.cli.folders import trials_folder

FIGURES = (".png", ".svg", ".pdf")
FOLDER = click.option(
    "--folder",
    envvar="FRUGAL_TRIALS",
    type=click.Path(path_type=Path),
    help="Where the trials are kept [default: where `frugal up` keeps those of --task].",
)
TASK = click.option("--task", type=click.Choice(list(TASKS)), default="plating", show_default=True)


@click.group()
def trials() -> None:
    """List, show, export and report trials that robots executed."""


@trials.command("list")
@FOLDER
@TASK
@click.option("--json", "as_json", is_flag=True, help="The trials as JSON on standard output.")
def list_trials(*, folder: Path | None, task: str, as_json: bool) -> None:
    """List the trials of a folder, in the order of recording.

    For people: item and what the outcome adds to the scene in cm3, actions in mm and rad. As JSON: SI units.
    """
    found = _find(folder, task)
    if as_json:
        click.echo(json.dumps([trial.model_dump(mode="json") | {"file": trial.file} for trial in found.trials]))
        return
    from rich.console import Console
    from rich.table import Column, Table

    names = ("number", "robot", "received", "item", "action, mm", "cm3", "added", "digest")
    drawn = Table(*(Column(name, no_wrap=True) for name in names), box=None, pad_edge=False)
    for trial in found.trials:
        drawn.add_row(
            str(trial.number),
            trial.robot,
            f"{trial.received.astimezone():%Y-%m-%d %H:%M}",
            "rigid" if trial.rigid else "soft",
            _told(trial),
            f"{trial.item_volume * 1e6:.0f}",
            f"{trial.added_volume * 1e6:.0f}",
            trial.digest[:8],
        )
    Console().print(drawn)


@trials.command()
@click.argument("number", type=click.IntRange(1))
@FOLDER
@TASK
@click.option("--out", type=click.Path(path_type=Path), required=True, help="The figure: .png, .svg or .pdf.")
def show(*, number: int, folder: Path | None, task: str, out: Path) -> None:
    """Draw trial NUMBER: scene, item, outcome, and what the action changed."""
    from common.storage.cases import read_case
    from pipelines.figures_trial import draw_trial

    if out.suffix not in FIGURES:
        raise RequestError(f"--out: expected a file of {', '.join(FIGURES)}, got {out}")
    where = folder or trials_folder(task)
    chosen = next((trial for trial in _find(folder, task).trials if trial.number == number), None)
    if chosen is None:
        raise RequestError(f"expected the number of a trial in {where}, got {number}")
    case = read_case(where / chosen.file)
    draw_trial(case, title=f"trial {number} of {chosen.robot}").savefig(out, dpi=110)
    say(f"drawn in {out}")


@trials.command()
@FOLDER
@TASK
@click.option("--out", type=click.Path(path_type=Path), required=True, help="Folder that the case files go to.")
@click.option("--robot", help="Only the trials of this robot.")
def export(*, folder: Path | None, task: str, out: Path, robot: str | None) -> None:
    """Copy the case files of trials into a folder, each after reading it whole; ends with 1 if one is broken."""
    from common.storage.cases import read_case

    where = folder or trials_folder(task)
    if out.resolve() == where.resolve():
        raise RequestError(f"--out: expected another folder than that of the trials, got {out}")
    found = _find(folder, task)
    chosen = [trial for trial in found.trials if robot in (None, trial.robot)]
    if not chosen:
        raise RequestError(f"expected trials{'' if robot is None else f' of {robot}'} in {where}, got none")
    out.mkdir(parents=True, exist_ok=True)
    broken = len(found.broken)
    for trial in chosen:
        try:
            read_case(where / trial.file)
        except RequestError as error:
            say(f"left out: {error}")
            broken += 1
            continue
        _copy(where / trial.file, out / trial.file)
    say(f"{len(list(out.glob('[!.]*.npz')))} case files in {out}")
    if broken:
        raise RequestError(f"expected only whole trials in {where}, left out {broken}")


@trials.command()
@click.argument("file", type=click.Path(path_type=Path))
@click.option("--robot", required=True, help="Who executed the action.")
@click.option("--id", "report_id", help="Name of the report: the same one again is no duplicate [default: a new one].")
@click.option("--json", "as_json", is_flag=True, help="The acknowledgement as JSON on standard output.")
def report(*, file: Path, robot: str, report_id: str | None, as_json: bool) -> None:
    """Send FILE, a case whose target is the outcome of its own action, to the running recorder of its task."""
    from common.storage.cases import read_case
    from common.wire.array import Array
    from common.wire.client import report_trial
    from common.wire.keys import check_name
    from common.wire.messages import new_id
    from common.wire.report import LONGEST_NOTES, TrialReport
    from common.wire.session import open_session
    from common.wire.settings import WireSettings
    from common.wire.state import StateMessage

    case = read_case(file)
    if case.reference_action is None:
        raise RequestError(f"{file}: expected a case whose target was made with its own item and action, got another")
    message = TrialReport(
        id=new_id() if report_id is None else check_name("--id", report_id),
        state=StateMessage.of(case.state),
        action=case.reference_action,
        outcome=Array.of(case.target),
        notes=case.notes[:LONGEST_NOTES],
    )
    with open_session(WireSettings()) as session:
        reply = report_trial(session, message, task=case.task, robot=robot)
    click.echo(reply.model_dump_json() if as_json else f"{reply.number} {reply.file}")


def _find(folder: Path | None, task: str) -> Record:
    """Return what a folder holds, after a line about everything that is left out."""
    found = find_trials(folder or trials_folder(task))
    for problem in found.broken:
        say(f"left out: {problem}")
    return found


def _told(trial: RecordedTrial) -> str:
    x, y, *turn = trial.action
    return f"{x * 1e3:+.1f} {y * 1e3:+.1f}" + "".join(f" {yaw:+.3f} rad" for yaw in turn)


def _copy(source: Path, target: Path) -> None:
    """Copy a file; it appears whole or not at all."""
    unfinished = target.with_name(f".{target.name}.partial")
    try:
        unfinished.write_bytes(source.read_bytes())
        unfinished.replace(target)
    finally:
        unfinished.unlink(missing_ok=True)
