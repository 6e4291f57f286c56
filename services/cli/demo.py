"""``frugal demo``: the whole path once, from starting the system to the figure."""

import os
import socket
import time
from pathlib import Path

import click

from common.wire.session import open_session, stop_on_signals
from common.wire.settings import WireSettings
from services.cli.asking import find_case, say
from services.cli.optimize import ask, make_request, prepare, report, save
from services.cli.processes import Crew
from services.cli.up import start_system, wait_until_ready
from services.cli.warm import compile_kernels


@click.command()
@click.argument("scene", default="01-steak-heap")
@click.option("--out", type=click.Path(path_type=Path), default=Path("out/demo"), show_default=True)
@click.option("--evaluations", type=click.IntRange(1, 5000), default=50, show_default=True)
@click.option("--in-flight", type=click.IntRange(1, 64), help="Default: as many as there are simulators.")
@click.option("--seed", type=click.IntRange(0, 2**63 - 1), default=0, show_default=True)
def demo(*, scene: str, out: Path, evaluations: int, in_flight: int | None, seed: int) -> None:
    """Start router, models, their MDEs and orchestrator, optimise SCENE, draw it, stop everything."""
    began = time.perf_counter()
    case = find_case(scene)
    prepare(out)
    compile_kernels()
    endpoint = f"tcp/127.0.0.1:{_free_port()}"
    settings = WireSettings(connect=(endpoint,), listen=(endpoint,))
    environment = os.environ | {"FRUGAL_CONNECT": endpoint, "FRUGAL_LISTEN": endpoint}
    stop = stop_on_signals()
    with Crew(environment=environment, log_folder=out / "logs") as crew:
        expected = start_system(crew, simulators=2)
        say(f"started {sum(expected.values()) + 1} processes; their logs are in {out / 'logs'}")
        wait_until_ready(crew, settings, expected, stopped=stop.is_set)
        request = make_request(case, evaluations=evaluations, in_flight=in_flight, seed=seed)
        with open_session(settings) as session:
            result = ask(session, request, progress=True, cancelled=stop.is_set)
        save(out, case, request, result)
    for line in report(case, result):
        say(line)
    say(f"all processes stopped; {time.perf_counter() - began:.1f} s in all")


def _free_port() -> int:
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        return probe.getsockname()[1]
