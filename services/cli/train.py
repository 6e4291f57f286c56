"""``frugal train``: the networks."""

import click

from services.cli.lazy import LazyGroup

TRAININGS: dict[str, tuple[str, str]] = {
    "learned": ("services.cli.train_learned:learned", "Train the learned model, and cross-fit it for its MDE."),
    "mde": ("services.cli.train_mde:mde", "Train the MDE of a model: of ours, or of one of your own."),
}
"""Name -> (where the command is, one line of help)."""


@click.group(cls=LazyGroup, lazy=TRAININGS)
def train() -> None:
    """Train networks on a data set; the same data, seed and settings give the same weights."""
