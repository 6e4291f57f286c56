"""``frugal optimize``: ask the running system."""

import json
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import click
import numpy as np
from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TaskID, TextColumn, TimeElapsedColumn

from common.domain.case import Case
from common.domain.trial import Result
from common.storage.results import action_error, other_errors, summarize, write_result
from common.tasks import TASKS
from common.wire import client
from common.wire.array import Array
from common.wire.optimization import OptimizeRequest
from common.wire.optimization import Progress as Step
from common.wire.query import never
from common.wire.session import Session, open_session
from common.wire.settings import WireSettings
from common.wire.state import StateMessage
from services.cli.asking import find_case, say


@click.command()
@click.argument("scene")
@click.option(
    "--strategy",
    default="quality",
    show_default=True,
    help="quality, balanced, fast, transport:calls=N, residual:calls=N, threshold (the paper's), only:<model>, random.",
)
@click.option("--task", type=click.Choice(list(TASKS)), help="What the orchestrator serves [default: SCENE's task].")
@click.option("--evaluations", type=click.IntRange(1, 5000), default=50, show_default=True)
@click.option(
    "--in-flight", type=click.IntRange(1, 64), help="Evaluations at a time [default: as many as there are simulators]."
)
@click.option("--seed", type=click.IntRange(0, 2**63 - 1), default=0, show_default=True)
@click.option("--d-max", type=click.FloatRange(0, 1, min_open=True), default=0.4, show_default=True)
@click.option("--deadline", type=click.FloatRange(0, min_open=True), help="Answer with the best known by then [s].")
@click.option("--out", type=click.Path(path_type=Path), help="Folder for result, trials and figure.")
@click.option("--json", "as_json", is_flag=True, help="The result as JSON on standard output.")
def optimize(
    *, scene: str, task: str | None, out: Path | None, as_json: bool, deadline: float | None, **options: object
) -> None:
    """Find the best action for SCENE, a case file or the name of a bundled scene.

    Prints the best action, x and y in metres and yaw in radians where the task has one, on standard output.
    """
    case = find_case(scene)
    case = case if task is None else retasked(case, task)
    request = make_request(case, deadline_s=deadline, **options)
    if out is not None:
        prepare(out)
    with open_session(WireSettings()) as session:
        result = ask(session, request, progress=not as_json)
    if out is not None:
        save(out, case, request, result)
    if as_json:
        click.echo(json.dumps(summarize(result, case=case, settings=settings_of(request)), indent=2))
    else:
        click.echo(" ".join(f"{value:.6f}" for value in result.action))
        for line in report(case, result):
            say(line)


def make_request(case: Case, **options: object) -> OptimizeRequest:
    """Return the request for a case; ``options`` are fields of the message."""
    state, target = StateMessage.of(case.state), Array.of(case.target)
    return OptimizeRequest.model_validate({"task": case.task, "state": state, "target": target, **options})


def retasked(case: Case, task: str) -> Case:
    """Return the case as one of another task; its true action is known there only if that task has such an action."""
    if task == case.task:
        return case
    known, count = case.true_action, len(TASKS[task].parameters)
    if known is not None:
        known = None if any(known[count:]) else (*known, *(0.0,) * count)[:count]
    return replace(case, task=task, true_action=known)


def settings_of(request: OptimizeRequest) -> dict[str, object]:
    """Return what was asked for, without the arrays."""
    return request.model_dump(mode="json", exclude={"state", "target", "id", "seed", "strategy"})


def ask(session: Session, request: OptimizeRequest, *, progress: bool, cancelled: Callable[[], bool] = never) -> Result:
    """Ask the system, with a progress bar if wanted."""
    if not progress:
        return client.optimize(session, request, cancelled=cancelled).result()
    console = Console(stderr=True)
    columns = (TextColumn("{task.description}"), BarColumn(), MofNCompleteColumn(), TimeElapsedColumn())
    with Progress(*columns, TextColumn("{task.fields[best]}"), console=console) as bar:
        row = bar.add_task("evaluations", total=request.evaluations, best="")
        return client.optimize(session, request, on_progress=_show(bar, row), cancelled=cancelled).result()


def _show(bar: Progress, row: TaskID) -> Callable[[Step], None]:
    best: list[float] = []

    def show(step: Step) -> None:
        if step.kind == "accepted":
            bar.update(row, total=step.evaluations)
        elif step.kind == "trial" and step.trial is not None:
            if step.trial.reward is not None:
                best[:] = [max([step.trial.reward, *best])]
            text = f"best {-best[0] * 1e3:.2f} mm, {step.trial.model}/{step.trial.instance}" if best else ""
            bar.update(row, advance=1, best=text)
        elif step.kind == "event" and step.event is not None:
            bar.console.print(f"{step.event.time:6.1f} s  {step.event.worker}: {step.event.kind}, {step.event.detail}")

    return show


def prepare(folder: Path) -> None:
    """Make the folder and load what draws the figure, before anything is paid for."""
    import pipelines.figures  # noqa: F401

    folder.mkdir(parents=True, exist_ok=True)


def save(folder: Path, case: Case, request: OptimizeRequest, result: Result) -> None:
    """Write result.json, trials.jsonl and the figure (PNG, SVG) into a folder."""
    from pipelines.figures import draw_placement, save_figure

    write_result(folder, result, case=case, settings=settings_of(request))
    png, svg = save_figure(draw_placement(case, result), folder / "placement")
    say(f"wrote {folder / 'result.json'}, {folder / 'trials.jsonl'}, {png}, {svg}")


def told(action: tuple[float, ...]) -> str:
    """Return an action for a person: the place in millimetres, a turn in degrees."""
    x, y, *turn = action
    return f"({x * 1e3:+.2f}, {y * 1e3:+.2f}) mm" + "".join(f" turned by {np.degrees(yaw):+.2f} deg" for yaw in turn)


def report(case: Case, result: Result) -> list[str]:
    """Return what a person wants to know, in a few lines."""
    error = action_error(result, case)
    where = f"best action {told(result.action)}, mean height error {-result.reward * 1e3:.3f} mm"
    if error is not None:
        turned = "".join(f" and {np.degrees(value):.2f} deg" for value in other_errors(result, case).values())
        where += f", {error * 1e3:.2f} mm{turned} from the true action"
    used = ", ".join(f"{model} {count}" for model, count in sorted(result.usage.items()))
    split = ", ".join(f"{name} {seconds:.2f}" for name, seconds in sorted(result.split_s.items()))
    lines = [
        where,
        f"{len(result.trials)} evaluations in {result.wall_s:.2f} s ({used})",
        f"seconds, calls at the same time added up, transport with waiting for a free worker: {split}",
    ]
    failed = [trial for trial in result.trials if trial.reward is None]
    warned = [trial for trial in result.trials if trial.warning]
    if (found := result.certificate) is not None:
        lines.append(
            f"no other of {found.actions} actions is better by more than {found.gain * 1e3:.3f} mm "
            f"(probability {found.probability:g}); {found.left:.0%} of the cheap model's best places may be better"
        )
    if failed:
        lines.append(f"{len(failed)} evaluations failed, the first: {failed[0].error}")
    if warned:
        lines.append(f"{len(warned)} outcomes with a warning, the first: {warned[0].warning}")
    if result.events:
        lines.append(f"{len(result.events)} events, the first: {result.events[0].worker} {result.events[0].kind}")
    return lines
