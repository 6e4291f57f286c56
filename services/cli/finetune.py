"""``frugal finetune``: from sim-to-sim to sim-to-real MDEs."""

import click

from services.cli.lazy import LazyGroup

FINETUNINGS: dict[str, tuple[str, str]] = {
    "mde": ("services.cli.finetune_mde:mde", "Fine-tune the MDE of a model on real trials."),
    "next": ("services.cli.finetune_next:next_actions", "Say which action to try next on the robot."),
}
"""Name -> (where the command is, one line of help)."""


@click.group(cls=LazyGroup, lazy=FINETUNINGS)
def finetune() -> None:
    """Make sim-to-real MDEs from real trials: case files with the executed action and the real outcome as target."""
