"""Data sets and trials that experiments need, by name, each made from its seed as by its command."""

from collections.abc import Callable
from pathlib import Path

import click

from common.domain.errors import RequestError
from services.cli.asking import say


def ensure(name: str, data: Path, *, workers: int) -> None:
    """Make a data set or a folder of trials if it is not there.

    Raises:
        RequestError: Nobody knows how to make it.
    """
    if is_there(name, data):
        return
    if name not in ASSETS:
        raise RequestError(f"{data / name}: expected a data set or trials of this name, got none")
    say(f"making {data / name}")
    ASSETS[name](name, data, workers)


def is_there(name: str, data: Path) -> bool:
    """Return whether a complete data set, or a folder with trials, is there."""
    return (data / name / "card.json").is_file() or any((data / name).glob("*/*.npz"))


def _narrow(name: str, data: Path, workers: int) -> None:
    """Make the paper's narrow setting, one soft steak."""
    from services.cli.data import generate

    with click.Context(generate) as ctx:
        ctx.invoke(generate, name=name, out=data, preset="narrow", train=1000, test=300, workers=workers)


ASSETS: dict[str, Callable[[str, Path, int], None]] = {"narrow-v1": _narrow}
"""Name -> function of (name, folder of the data sets, processes) that makes it."""
