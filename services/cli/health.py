"""``frugal health``: is the process of this machine well? For health checks of containers, so it imports little."""

import click

from common.wire.probe import health_key, probe
from services.cli.instance import own_host


@click.command()
@click.argument("name")
@click.option("--instance", envvar="FRUGAL_INSTANCE", help="Which process; default: any of this machine.")
@click.option("--connect", envvar="FRUGAL_CONNECT", default="tcp/127.0.0.1:7447", show_default=True)
@click.option("--zenoh-config", envvar="FRUGAL_ZENOH_CONFIG", help="A Zenoh configuration file to start from.")
def health(*, name: str, instance: str | None, connect: str, zenoh_config: str | None) -> None:
    """Exit with 0 if the router, or this machine's worker NAME, answers.

    NAME is a model, mde/<model>, or a role without a model: orchestrator, recorder, world.
    """
    key = None if name == "router" else health_key(name, instance=instance or f"{own_host()}-$*")
    probe(key, connect=[part.strip() for part in connect.split(",")], zenoh_config=zenoh_config)
    click.echo(f"{name}: answers")
