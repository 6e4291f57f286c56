"""``frugal watch``: a live view of workers and running optimisations."""

import time
from collections import OrderedDict
from dataclasses import dataclass

import click
from rich import box
from rich.console import Group, RenderableType
from rich.live import Live
from rich.table import Table

from common.domain.errors import UnavailableError
from common.wire.client import follow_progress, list_workers
from common.wire.optimization import Progress
from common.wire.session import Session, open_session
from common.wire.settings import WireSettings
from services.cli.workers import table

SHOWN = 12


@dataclass
class Run:
    """What is known of one optimisation."""

    strategy: str = "?"
    evaluations: int = 0
    done: int = 0
    best: float | None = None
    state: str = "running"
    last: str = ""


class Runs:
    """Running and lately ended optimisations, gathered from their progress."""

    def __init__(self) -> None:
        self._runs: OrderedDict[str, Run] = OrderedDict()

    def add(self, step: Progress) -> None:
        """Take one step in."""
        run = self._runs.setdefault(step.id, Run())
        if step.kind == "accepted":
            run.strategy, run.evaluations, run.done = step.strategy or "?", step.evaluations or 0, 0
        elif step.trial is not None:
            run.done += 1
            run.last = f"{step.trial.model}/{step.trial.instance}"
            if step.trial.reward is not None:
                run.best = max(step.trial.reward, step.trial.reward if run.best is None else run.best)
        elif step.event is not None:
            run.last = f"{step.event.worker}: {step.event.kind}"
        elif step.kind in ("finished", "failed"):
            run.state = step.kind if step.error is None else f"failed: {step.error.message}"[:60]
        while len(self._runs) > SHOWN:
            self._runs.popitem(last=False)

    def table(self) -> Table:
        """Return the table for a terminal."""
        names = ("optimisation", "strategy", "evaluations", "best [mm]", "state", "last")
        drawn = Table(*names, box=box.SIMPLE_HEAD, pad_edge=False)
        for name, run in reversed(tuple(self._runs.items())):
            best = "" if run.best is None else f"{-run.best * 1e3:.3f}"
            drawn.add_row(name[:12], run.strategy, f"{run.done}/{run.evaluations}", best, run.state, run.last)
        return drawn


@click.command()
@click.option("--interval", type=click.FloatRange(0.2, 60), default=1.0, show_default=True, help="Seconds.")
@click.option("--once", is_flag=True, help="Print the view once and leave.")
def watch(*, interval: float, once: bool) -> None:
    """Watch workers and running optimisations until interrupted."""
    runs = Runs()
    with open_session(WireSettings()) as session, follow_progress(session, runs.add), Live() as live:
        live.update(view(session, runs), refresh=True)
        while not once:
            time.sleep(interval)
            live.update(view(session, runs))


def view(session: Session, runs: Runs) -> Group:
    """Return what is to be seen now; a router that is gone for a while is part of it."""
    try:
        workers: RenderableType = table(list_workers(session))
    except UnavailableError as error:
        workers = str(error)
    return Group(workers, runs.table())
