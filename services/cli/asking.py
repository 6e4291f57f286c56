"""What the commands share: a session, a case by name, lines for people."""

from pathlib import Path

import click

from common.domain.case import Case
from common.domain.errors import RequestError
from common.storage.cases import read_case

EXAMPLES = Path(__file__).resolve().parents[2] / "examples"
SCENES = (EXAMPLES / "scenes", EXAMPLES / "scenes_yaw")
"""The bundled scenes of a checkout."""


def find_case(name: str) -> Case:
    """Return a case by its path or by the name of a bundled scene.

    Raises:
        RequestError: There is neither such a file nor such a scene, or the file is not a case.
    """
    path = Path(name)
    if path.suffix == ".npz" or path.exists():
        return read_case(path)
    bundled = {found.stem: found for folder in SCENES for found in sorted(folder.glob("*.npz"))}
    if name not in bundled:
        raise RequestError(f"expected a case file or one of {', '.join(bundled) or 'no bundled scene'}, got {name!r}")
    return read_case(bundled[name])


def say(text: str) -> None:
    """Print a line for a person; standard output is left to results."""
    click.echo(text, err=True)
