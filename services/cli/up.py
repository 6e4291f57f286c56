"""``frugal up``: the whole system on one machine."""

import os
import time
from collections import Counter
from collections.abc import Callable
from pathlib import Path

import click

from common.domain.errors import UnavailableError
from common.tasks import TASKS
from common.wire.client import list_workers
from common.wire.keys import Address
from common.wire.session import open_session, stop_on_signals
from common.wire.settings import WireSettings
from services.cli.asking import say
from services.cli.folders import state_folder, trials_folder
from services.cli.processes import Crew
from services.cli.released import is_released
from services.cli.warm import compile_kernels

READY_S = 180.0
ESTIMATED = ("heuristic", "learned")
"""Models whose MDEs are released."""
JOURNAL, TRIALS = "FRUGAL_ORCHESTRATOR_JOURNAL", "FRUGAL_TRIALS"


@click.command()
@click.option("--task", type=click.Choice(list(TASKS)), default="plating", show_default=True, help="What is served.")
@click.option("--simulators", type=click.IntRange(1, 64), default=2, show_default=True, help="Simulator workers.")
@click.option(
    "--logs", type=click.Path(path_type=Path), help="Folder for one log a process; else all on this terminal."
)
def up(*, task: str, simulators: int, logs: Path | None) -> None:
    """Start router, models, their MDEs, orchestrator and recorder, and keep them running until interrupted.

    The learned model and the MDEs are started where their released weights are.

    The router listens at FRUGAL_LISTEN (default tcp/127.0.0.1:7447). A process that ends is restarted. An optimisation
    that was interrupted goes on when the same request comes again; until then it is kept in the folder
    FRUGAL_ORCHESTRATOR_JOURNAL (default: frugal/journal in the user's folder for state; empty: nowhere). Trials that
    robots report are kept in the folder FRUGAL_TRIALS (default: frugal/trials/<task> there; empty: nobody takes them).
    """
    stop = stop_on_signals()
    settings = WireSettings()
    own = settings.model_copy(update={"connect": settings.listen})
    check_free(own)
    compile_kernels()
    folders = {JOURNAL: str(state_folder() / "journal"), TRIALS: str(trials_folder(task))}
    environment = {**folders, **os.environ, "FRUGAL_CONNECT": ",".join(settings.listen)}
    with Crew(environment=environment, log_folder=logs) as crew:
        expected = start_system(crew, simulators=simulators, task=task, has_recorder=bool(environment[TRIALS]))
        wait_until_ready(crew, own, expected, stopped=stop.is_set)
        say("ready; stop with Ctrl-C")
        while not stop.wait(0.5):
            for news in crew.mend():
                say(news)
        say("stopping")


def check_free(settings: WireSettings) -> None:
    """Raise `UnavailableError` if a router listens already: a second system would join the first one's."""
    try:
        session = open_session(settings, wait_s=0.0)
    except UnavailableError:
        return
    session.close()
    where = ", ".join(settings.connect)
    raise UnavailableError(f"expected nobody to listen at {where}, got a router: is the system up already?")


def start_system(crew: Crew, *, simulators: int, task: str = "plating", has_recorder: bool = False) -> Counter[str]:
    """Start every process, a recorder only if wanted, and return how many workers of each name there will be."""

    def start(name: str, *arguments: str) -> None:
        crew.start(name, *arguments, "--task", task)

    crew.start("router", "router")
    start("heuristic", "heuristic", "--instance", "heuristic-1")
    for number in range(1, simulators + 1):
        start(f"simulator-{number}", "simulator", "--instance", f"simulator-{number}")
    start("orchestrator", "orchestrator", "--instance", "orchestrator-1")
    expected = Counter({"heuristic": 1, "simulator": simulators, "orchestrator": 1})
    if is_released("learned"):
        start("learned", "learned", "--instance", "learned-1")
        expected["learned"] = 1
    for model in ESTIMATED:
        if is_released(f"mde_{model}"):
            start(f"mde-{model}", "mde", "--model", model, "--instance", f"mde-{model}-1")
            expected[f"mde/{model}"] = 1
    if has_recorder:
        start("recorder", "recorder", "--instance", "recorder-1")
        expected["recorder"] = 1
    return expected


def worker_name(address: Address) -> str:
    """Return what kind of worker an address is of: its model, ``mde/<model>``, or its role if it has no model."""
    if address.role == "mde":
        return f"mde/{address.model}"
    return address.model or address.role


def wait_until_ready(
    crew: Crew, settings: WireSettings, expected: Counter[str], *, stopped: Callable[[], bool]
) -> None:
    """Wait until all expected workers are alive; the first time, that includes compiling the simulator's kernels.

    Raises:
        UnavailableError: A process ended, or not all were there after `READY_S`.
    """
    deadline = time.monotonic() + READY_S
    missing = expected
    with open_session(settings, wait_s=20.0) as session:
        while not stopped():
            live = Counter(worker_name(status.address) for status in list_workers(session))
            missing = expected - live
            if ended := crew.ended():
                raise UnavailableError(
                    f"expected all processes to start, got an end of {', '.join(ended)}: see its log"
                )
            if not missing:
                return
            if time.monotonic() > deadline:
                raise UnavailableError(f"expected all workers within {READY_S:g} s, still missing {dict(missing)}")
            time.sleep(0.2)
