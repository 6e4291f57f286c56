"""``frugal evaluate``: the paper's tables and experiments."""

import click

from services.cli.lazy import LazyGroup

EXPERIMENTS: dict[str, tuple[str, str]] = {
    "table1": ("services.cli.evaluate_table1:table1", "How far the models are from the trusted outcome (Table I)."),
    "table2": ("services.cli.evaluate_table2:table2", "How good the MDEs are, by model and variant (Table II)."),
    "certificate": (
        "services.cli.evaluate_certificate:certificate",
        "How often the certificate of an optimisation is wrong, and how much it allows.",
    ),
    "strategies": (
        "services.cli.evaluate_strategies:strategies",
        "Compare strategies with the simulator alone on the same targets.",
    ),
    "threshold": (
        "services.cli.evaluate_threshold:threshold",
        "Optimise held-out targets with all models and with the simulator alone.",
    ),
}
"""Name -> (where the command is, one line of help)."""


@click.group(cls=LazyGroup, lazy=EXPERIMENTS)
def evaluate() -> None:
    """Measure models, MDEs and whole optimisations on held-out data."""
