"""``frugal serve``: one process of the system."""

import importlib.util
import logging
import os
import signal
import sys
import threading
from pathlib import Path

import click

from common.domain.deviation import DeviationEstimator
from common.domain.errors import RequestError
from common.domain.grid import Grid
from common.domain.model import PredictiveModel
from common.tasks import TASKS
from common.wire.settings import WireSettings
from services.cli.instance import own_instance
from services.simulator.settings import LEVELS

INSTANCE = click.option(
    "--instance", envvar="FRUGAL_INSTANCE", default=own_instance, help="Name of this process in the keys."
)
TASK = click.option("--task", type=click.Choice(list(TASKS)), default="plating", show_default=True)
"""A model or MDE of (x, y) also serves ``plating_yaw``: it is asked about turned items."""


@click.group()
@click.option("--until-eof", is_flag=True, help="Stop when standard input ends, as it does when the parent dies.")
@click.option("--log-level", type=click.Choice(["debug", "info", "warning"]), default="info", show_default=True)
def serve(*, until_eof: bool, log_level: str) -> None:
    """Run one process of the system until SIGTERM or SIGINT.

    The router listens at FRUGAL_LISTEN; all others connect to FRUGAL_CONNECT (default: tcp/127.0.0.1:7447) and wait
    until the router is there.
    """
    logging.basicConfig(level=log_level.upper(), format="%(asctime)s %(process)d %(name)s: %(message)s")
    if until_eof:
        threading.Thread(target=_stop_at_eof, daemon=True).start()


@serve.command()
def router() -> None:
    """Route between all other processes."""
    from common.wire.router import run_router

    sys.exit(run_router(WireSettings()))


@serve.command()
@INSTANCE
@TASK
def heuristic(*, instance: str, task: str) -> None:
    """Serve the heuristic model."""
    from services.heuristic import HeuristicModel

    _serve_model(HeuristicModel(), instance=instance, task=task)


@serve.command()
@click.option("--weights", type=click.Path(path_type=Path), help="Folder of its weights [default: the released ones].")
@INSTANCE
@TASK
def learned(*, weights: Path | None, instance: str, task: str) -> None:
    """Serve the learned model; weights that are not what their card says are refused."""
    from services.cli.released import released
    from services.learned.load import load_learned

    served = load_learned(weights or released("learned"))
    _serve_model(served, instance=instance, task=task, weights=served.weights, grid=served.grid)


@serve.command()
@INSTANCE
@TASK
@click.option("--level", type=click.Choice(list(LEVELS)), default="default", show_default=True, help="Resolution.")
@click.option("--device", default="cpu", show_default=True, help="Warp's name of the device.")
@click.option("--threads", default=1, show_default=True, help="Actions of one batch simulated at the same time.")
def simulator(*, instance: str, task: str, level: str, device: str, threads: int) -> None:
    """Serve the simulator; its kernels are compiled before it joins.

    At a level other than ``default`` it is a model of its own: simulator_coarse, simulator_fine.
    """
    from services.simulator.model import SimulatorModel

    served = SimulatorModel.at_level(level, device=device, threads=threads)
    served.warm()
    _serve_model(served, instance=instance, task=task, device=device)


@serve.command()
@click.argument("where", metavar="FILE.py:CLASS")
@INSTANCE
@TASK
def model(*, where: str, instance: str, task: str) -> None:
    """Serve a model of your own: a class in a file, a PredictiveModel that needs no arguments."""
    _serve_model(load_model(where), instance=instance, task=task)


@serve.command()
@click.option("--model", "estimated", required=True, help="The model whose deviation is estimated.")
@click.option("--weights", type=click.Path(path_type=Path), help="Folder of its weights [default: the released ones].")
@INSTANCE
@TASK
def mde(*, estimated: str, weights: Path | None, instance: str, task: str) -> None:
    """Serve the MDE of a model; weights that are not what their card says are refused."""
    from common.wire.host import Host
    from common.wire.run import run_host
    from common.wire.serve import host_estimator
    from common.wire.session import Session
    from services.cli.released import released
    from services.mde.estimator import parse_estimator, read_estimator

    chosen, name = TASKS[task], f"mde_{estimated}"
    folder = weights or released(name)
    first = read_estimator(folder, model=estimated, threads=1)

    def build(session: Session) -> Host:
        now = weights or released(name)  # the router may have come long after the weights were read
        served = first if now == folder else read_estimator(now, model=estimated, threads=1)

        def load(card: bytes, tensors: bytes) -> tuple[DeviationEstimator, str]:
            found = parse_estimator(card, tensors, instead_of=served)
            return chosen.adapt_estimator(found), found.weights

        return host_estimator(
            session,
            chosen.adapt_estimator(served),
            task=task,
            instance=instance,
            weights=served.weights,
            parameters=chosen.names,
            load=load,
        )

    sys.exit(run_host(build, WireSettings()))


@serve.command()
@INSTANCE
@TASK
def orchestrator(*, instance: str, task: str) -> None:
    """Answer ``optimize`` queries."""
    from services.orchestrator import OrchestratorSettings, run_orchestrator

    sys.exit(run_orchestrator(WireSettings(), OrchestratorSettings(), task=TASKS[task], instance=instance))


@serve.command()
@INSTANCE
@TASK
def world(*, instance: str, task: str) -> None:
    """Serve the world's stand-in: it shows tables to a depth camera and executes actions on them."""
    from common.wire.run import run_host
    from common.wire.serve_world import host_world
    from services.world.world import StandIn

    served = StandIn()
    served.warm()
    sys.exit(run_host(lambda session: host_world(session, served, task=task, instance=instance), WireSettings()))


@serve.command()
@INSTANCE
@TASK
@click.option(
    "--folder",
    envvar="FRUGAL_TRIALS",
    type=click.Path(path_type=Path),
    required=True,
    help="Where the trials are kept; one recorder writes to it.",
)
@click.option(
    "--grid",
    type=(int, int, float),
    metavar="ROWS COLUMNS CELL",
    help="The only grid that is taken, cell in metres [default: that of the first trial].",
)
def recorder(*, instance: str, task: str, folder: Path, grid: tuple[int, int, float] | None) -> None:
    """Keep the trials that robots report."""
    from services.recorder import run_recorder

    taken = None if grid is None else Grid(*grid)
    sys.exit(run_recorder(WireSettings(), task=TASKS[task], instance=instance, folder=folder, grid=taken))


def load_model(where: str) -> PredictiveModel:
    """Return an instance of a class in a file, ``path/to/file.py:Class``.

    Raises:
        RequestError: There is no such file or class, or it is no `PredictiveModel`.
    """
    path, _, name = where.rpartition(":")
    if not name or not Path(path).is_file():
        raise RequestError(f"expected FILE.py:CLASS with an existing file, got {where!r}")
    spec = importlib.util.spec_from_file_location("served_model", path)
    if spec is None or spec.loader is None:
        raise RequestError(f"expected a Python file, got {path}")
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    found = getattr(module, name, None)
    if not (isinstance(found, type) and issubclass(found, PredictiveModel)):
        raise RequestError(f"expected a subclass of PredictiveModel named {name} in {path}, got {found!r}")
    return found()


def _serve_model(
    served: PredictiveModel,
    *,
    instance: str,
    task: str,
    device: str = "cpu",
    weights: str | None = None,
    grid: Grid | None = None,
) -> None:
    """Serve a model as the task takes it until the process is told to stop."""
    from common.wire.run import run_host
    from common.wire.serve import host_model

    chosen = TASKS[task]
    adapted = chosen.adapt_model(served)
    sys.exit(
        run_host(
            lambda session: host_model(
                session,
                adapted,
                task=task,
                instance=instance,
                weights=weights,
                device=device,
                grid=grid,
                parameters=chosen.names,
            ),
            WireSettings(),
        )
    )


def _stop_at_eof() -> None:
    while os.read(0, 4096):  # the buffered reader would hold its lock when the interpreter ends
        pass
    os.kill(os.getpid(), signal.SIGTERM)
