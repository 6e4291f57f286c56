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
    if (data / name / "card.json").is_file():
        return
    if name not in ASSETS:
        if any((data / name).glob("*/*.npz")):
            return
        raise RequestError(f"{data / name}: expected a data set or trials of this name, got none")
    say(f"making {data / name}")
    ASSETS[name](name, data, workers)


def _narrow(name: str, data: Path, workers: int) -> None:
    """Make the paper's narrow setting, one soft steak."""
    from services.cli.data import generate

    with click.Context(generate) as ctx:
        ctx.invoke(generate, name=name, out=data, preset="narrow", train=1000, test=300, workers=workers)


def _real(name: str, data: Path, workers: int) -> None:
    """Make the trials in the world's stand-in."""
    from services.cli.data_real import make_real

    make_real(data / name, workers=workers)


ASSETS: dict[str, Callable[[str, Path, int], None]] = {"narrow-v1": _narrow, "real-v1": _real}
"""Name -> function of (name, folder of the data sets, processes) that makes it."""
