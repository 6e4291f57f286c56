"""``frugal health``: is the process of this machine well? For health checks of containers."""

import click

from common.domain.errors import UnavailableError
from common.wire.client import list_workers
from common.wire.session import open_session
from common.wire.settings import WireSettings
from services.cli.serve import own_instance


@click.command()
@click.argument("name")
@click.option("--instance", envvar="FRUGAL_INSTANCE", default=None, help="Which process; FRUGAL_INSTANCE by default.")
def health(*, name: str, instance: str | None) -> None:
    """Exit with 0 if the router, or this machine's worker NAME (a model, or orchestrator), answers."""
    with open_session(WireSettings()) as session:
        if name == "router":
            return
        host = own_instance().rpartition("-")[0]
        for status in list_workers(session):
            mine = status.address.instance == instance if instance else status.address.instance.startswith(f"{host}-")
            if mine and (status.address.model or status.address.role) == name and status.health is not None:
                click.echo(f"{status.address.worker}: {status.health.status}")
                return
    raise UnavailableError(f"expected an answer from {name} of {instance or host}, got none")
