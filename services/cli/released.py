"""Where released weights are."""

import os
from pathlib import Path

from common.storage.registry import Registry

MODELS = Path(__file__).resolve().parents[2] / "models"
"""The released weights of a checkout."""


def models_folder() -> Path:
    """Return the folder of all weights: FRUGAL_MODELS if that is set, else the checkout's ``models``."""
    return Path(os.environ.get("FRUGAL_MODELS") or MODELS)


def registry() -> Registry:
    """Return all weights and their versions."""
    return Registry(models_folder())


def released(name: str) -> Path:
    """Return the folder of weights by name, of the active version.

    Raises:
        RequestError: A version was promoted that is not there any more.
    """
    return registry().folder(name)


def is_released(name: str) -> bool:
    """Return whether there are weights of this name."""
    return (released(name) / "card.json").is_file()
