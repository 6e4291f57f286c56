"""``frugal warm``."""

import time

import click


@click.command()
def warm() -> None:
    """Compile the simulator's kernels into the cache, so that the first placement does not wait for it.

    The cache's folder can be set with the environment variable WARP_CACHE_PATH.
    """
    from services.simulator.model import warm as warm_kernels

    start = time.perf_counter()
    click.echo("compiling the simulator's kernels (about 15 s the first time)", err=True)
    warm_kernels()
    click.echo(f"kernels ready after {time.perf_counter() - start:.1f} s")
