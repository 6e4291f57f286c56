"""Where released weights are."""

import os
from pathlib import Path

from common.storage.registry import Registry

MODELS = Path(__file__).resolve().parents[2] / "models"
"""The released weights of a checkout."""


def registry() -> Registry:
    """Return all weights and their versions: in FRUGAL_MODELS if that is set, else in the checkout's ``models``."""
    return Registry(Path(os.environ.get("FRUGAL_MODELS") or MODELS))


def released(name: str) -> Path:
    """Return the folder of weights by name, of the active version.

    Raises:
        RequestError: A version was promoted that is not there any more.
    """
    return registry().folder(name)


def is_released(name: str) -> bool:
    """Return whether there are weights of this name."""
    return (released(name) / "card.json").is_file()
