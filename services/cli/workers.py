"""``frugal workers`` and ``frugal health``: who is there."""

import json

import click
from rich import box
from rich.console import Console
from rich.table import Column, Table

from common.wire.client import WorkerStatus, list_workers
from common.wire.session import open_session
from common.wire.settings import WireSettings


@click.command()
@click.option("--json", "as_json", is_flag=True, help="Cards and health as JSON.")
def workers(*, as_json: bool) -> None:
    """List the live workers with their cards, health and measured cost."""
    with open_session(WireSettings()) as session:
        found = list_workers(session)
    if as_json:
        click.echo(json.dumps([describe(status) for status in found], indent=2))
    else:
        Console().print(table(found))


def describe(status: WorkerStatus) -> dict[str, object]:
    """Return a worker as plain values."""
    address = status.address
    return {
        "task": address.task,
        "role": address.role,
        "model": address.model,
        "instance": address.instance,
        "card": status.card and status.card.model_dump(mode="json"),
        "health": status.health and status.health.model_dump(mode="json"),
    }


def table(found: tuple[WorkerStatus, ...]) -> Table:
    """Return a table of workers for a terminal, narrow enough for 80 columns."""
    names = ("worker", "version", "state", "waiting", "served", "failed", "cost")
    drawn = Table(*(Column(name, no_wrap=True) for name in names), box=box.SIMPLE_HEAD, pad_edge=False)
    for status in found:
        card, health = status.card, status.health
        address = status.address
        kind = "MDE " if address.role == "mde" else ""
        cost = "" if health is None else ", ".join(f"{1e3 * c.p50_s:.3g} ms / {c.batch}" for c in health.cost[:1])
        drawn.add_row(
            kind + address.worker,
            card.version if card else "?",
            "no answer" if health is None else "computing" if health.in_progress else health.status,
            str(health.queue_length) if health else "",
            str(health.served) if health else "",
            str(health.failed) if health else "",
            cost,
        )
    return drawn
