"""Where released weights are."""

import os
from pathlib import Path

MODELS = Path(__file__).resolve().parents[2] / "models"
"""The released weights of a checkout."""


def released(name: str) -> Path:
    """Return the folder of weights by name: in FRUGAL_MODELS if that is set, else in the checkout's ``models``."""
    return Path(os.environ.get("FRUGAL_MODELS") or MODELS) / name


def is_released(name: str) -> bool:
    """Return whether there are weights of this name."""
    return (released(name) / "card.json").is_file()
