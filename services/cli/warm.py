"""``frugal warm``."""

import time

import click

from services.cli.asking import say


@click.command()
def warm() -> None:
    """Compile the simulator's kernels into the cache, so that the first placement does not wait for it.

    The cache's folder can be set with the environment variable WARP_CACHE_PATH.
    """
    compile_kernels()


def compile_kernels() -> None:
    """Compile or load all kernels and say how long it took."""
    from services.simulator.model import SimulatorModel

    start = time.perf_counter()
    say("loading the simulator's kernels (compiled the first time, about 15 s)")
    SimulatorModel().warm()
    say(f"kernels ready after {time.perf_counter() - start:.1f} s")
