"""Where a user's own files are, unless the environment says otherwise."""

import os
from pathlib import Path


def state_folder() -> Path:
    """Return the folder of what has to survive a restart, by the XDG base directories."""
    state = os.environ.get("XDG_STATE_HOME") or Path.home() / ".local" / "state"
    return Path(state) / "frugal"


def trials_folder(task: str) -> Path:
    """Return where this user's recorder of a task keeps its trials."""
    return state_folder() / "trials" / task
