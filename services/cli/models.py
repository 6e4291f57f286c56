"""``frugal models``: versions of weights, and which of them the workers answer with."""

import json
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import click
from rich import box
from rich.console import Console
from rich.table import Table

from common.domain.errors import FrugalError, RequestError, UnavailableError
from common.storage.promotion import Promotion
from common.storage.registry import Version
from common.wire.client import list_workers
from common.wire.session import Session, open_session
from common.wire.settings import WireSettings
from services.cli.asking import say
from services.cli.released import registry

WAIT_S = 60.0


@click.group()
def models() -> None:
    """Versions of the weights in FRUGAL_MODELS: list them, promote one, or go back to the one before.

    Running workers of an MDE take a promoted version over between two requests; those that start later begin with it.
    """


@models.command("list")
@click.argument("name", required=False)
@click.option("--json", "as_json", is_flag=True, help="All versions as JSON.")
def list_versions(*, name: str | None, as_json: bool) -> None:
    """List all versions, of one name or of all, and the live workers that answer with them."""
    found = registry()
    versions = [version for each in ((name,) if name else found.names()) for version in found.versions(each)]
    live = _live_weights()
    rows = [_described(version, live) for version in versions]
    if as_json:
        click.echo(json.dumps(rows, indent=2))
        return
    drawn = Table("name", "version", "active", "trained on", "MAE", "workers", box=box.SIMPLE_HEAD, pad_edge=False)
    for row in rows:
        data = row["dataset"]
        error = "" if row["mae"] is None else f"{row['mae']:.3f}"
        drawn.add_row(
            row["name"],
            row["version"],
            "yes" if row["active"] else "",
            f"{data.get('name')}, {data.get('samples')}",
            error,
            ", ".join(row["workers"]),
        )
    Console(width=140).print(drawn)


@models.command()
@click.argument("name")
@click.argument("version", metavar="VERSION|FOLDER")
@click.option("--wait", is_flag=True, help=f"Wait up to {WAIT_S:g} s for a router and a worker that takes it over.")
def promote(*, name: str, version: str, wait: bool) -> None:
    """Make a version of weights the active one; a folder of new weights is added first.

    If a live worker refuses them, the version before stays active everywhere, and a folder is not added.
    """
    found = registry()
    with found.turn(), _session(wait_s=WAIT_S if wait else 0.0) as session:
        known = {one.version for one in found.versions(name)} if name in found.names() else set()
        if version not in known and ("/" in version or Path(version).is_dir()):
            version = found.add(name, Path(version)).version
        promotion = Promotion(found, name, session, say)
        try:
            if wait:
                promotion.wait_for_worker(timeout_s=WAIT_S)
            promotion.promote(version)
        except (FrugalError, KeyboardInterrupt):
            if version not in known:
                found.remove(name, version)
            raise
    say(f"{name}: {version} is active")


@models.command()
@click.argument("name")
def rollback(*, name: str) -> None:
    """Make the version active again that was active before."""
    found = registry()
    with found.turn(), _session(wait_s=0.0) as session:
        previous = Promotion(found, name, session, say).rollback()
    say(f"{name}: {previous.version} is active")


@contextmanager
def _session(*, wait_s: float) -> Iterator[Session | None]:
    """Open a session; None if there is no router in time [s]."""
    try:
        opened = open_session(WireSettings(), wait_s=wait_s)
    except UnavailableError:
        yield None
        return
    with opened:
        yield opened


def _live_weights() -> dict[str, list[str]]:
    """Return the workers by the SHA-256 of what they answer with; none if there is no router."""
    live: dict[str, list[str]] = {}
    with _session(wait_s=0.0) as session:
        for status in () if session is None else list_workers(session):
            if status.card is not None and status.card.weights is not None:
                live.setdefault(status.card.weights, []).append(status.address.worker)
    return live


def _described(version: Version, live: dict[str, list[str]]) -> dict[str, Any]:
    card = version.card
    dataset, metrics = card.get("dataset"), card.get("metrics")
    held_out = metrics.get("held_out") if isinstance(metrics, dict) else None
    if not isinstance(dataset, dict):
        raise RequestError(f"{version.folder}: expected a card that names its data set, got {dataset!r:.80}")
    return {
        "name": version.name,
        "version": version.version,
        "active": version.is_active,
        "dataset": dataset,
        "mae": held_out.get("mae") if isinstance(held_out, dict) else None,
        "sha256": card["sha256"],
        "folder": str(version.folder),
        "workers": live.get(card["sha256"], []),
    }
