"""``frugal models``: versions of weights, and which of them the workers answer with."""

import json
from pathlib import Path
from typing import Any

import click
from rich import box
from rich.console import Console
from rich.table import Table

from common.domain.errors import FrugalError, RequestError, UnavailableError
from common.storage.registry import CARD, TENSORS, Version
from common.wire.client import WorkerStatus, list_workers
from common.wire.messages import LoadReply, LoadRequest
from common.wire.query import ask
from common.wire.session import Session, open_session
from common.wire.settings import WireSettings
from services.cli.asking import say
from services.cli.released import registry

LOAD_S = 30.0
"""Time that a worker gets to take weights over [s]."""
PREFIX = "mde_"


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
def promote(*, name: str, version: str) -> None:
    """Make a version of weights the active one; a folder of new weights is added first.

    If a live worker refuses them, the version before stays active everywhere.
    """
    found = registry()
    if "/" in version or Path(version).is_dir():
        version = found.add(name, Path(version)).version
    before = next(one for one in found.versions(name) if one.is_active)
    promoted = found.promote(name, version)
    try:
        _tell_workers(promoted)
    except FrugalError:
        if before.version != version:
            found.rollback(name)
            _tell_workers(before, quiet=True)
        raise
    say(f"{name}: {version} is active")


@models.command()
@click.argument("name")
def rollback(*, name: str) -> None:
    """Make the version active again that was active before."""
    previous = registry().rollback(name)
    _tell_workers(previous)
    say(f"{name}: {previous.version} is active")


def _tell_workers(version: Version, *, quiet: bool = False) -> None:
    """Give the weights to all live workers of their MDE.

    Raises:
        FrugalError: One did not take them over; the others have.
    """
    kind = version.name.rpartition("/")[2]
    if not kind.startswith(PREFIX):
        say(f"{version.name}: workers take it over when they start again")
        return
    request = LoadRequest(card=(version.folder / CARD).read_bytes(), tensors=(version.folder / TENSORS).read_bytes())
    try:
        with open_session(WireSettings(), wait_s=0.0) as session:
            failure = _load_everywhere(session, kind.removeprefix(PREFIX), request, quiet=quiet)
    except UnavailableError:
        say("no router: workers take it over when they start again")
        return
    if failure is not None:
        raise failure


def _load_everywhere(session: Session, model: str, request: LoadRequest, *, quiet: bool) -> FrugalError | None:
    """Return the error of the first worker that refused, None if none did."""
    failure: FrugalError | None = None
    for worker in _estimators(session, model):
        try:
            reply = ask(session, worker.address.key("load"), request, LoadReply, timeout_s=LOAD_S)
            if not quiet:
                say(f"{worker.address.worker}: {reply.version}, before {reply.previous}")
        except FrugalError as error:
            say(f"{worker.address.worker}: {error.code}: {error}")
            failure = failure or type(error)(f"{worker.address.worker}: {error}")
    return failure


def _estimators(session: Session, model: str) -> list[WorkerStatus]:
    found = [one for one in list_workers(session) if (one.address.role, one.address.model) == ("mde", model)]
    if not found:
        say(f"no live worker of the MDE of {model}: the next one that starts begins with it")
    return found


def _live_weights() -> dict[str, list[str]]:
    """Return the workers by the SHA-256 of what they answer with; none if there is no router."""
    try:
        with open_session(WireSettings(), wait_s=0.0) as session:
            live: dict[str, list[str]] = {}
            for status in list_workers(session):
                if status.card is not None and status.card.weights is not None:
                    live.setdefault(status.card.weights, []).append(status.address.worker)
            return live
    except UnavailableError:
        return {}


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
