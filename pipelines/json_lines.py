"""Files of JSON Lines that a run appends to."""

import json
from pathlib import Path
from typing import Any

from common.domain.errors import RequestError


def read_json_lines(path: Path) -> list[dict[str, Any]]:
    """Return the lines of a file; a last one that an interruption broke is left out.

    Raises:
        RequestError: Another line is no JSON.
    """
    lines: list[dict[str, Any]] = []
    texts = path.read_text().splitlines()
    for number, text in enumerate(texts, start=1):
        try:
            lines.append(json.loads(text))
        except ValueError:
            if number < len(texts):
                raise RequestError(f"{path}: expected JSON in line {number}, got {text[:80]!r}") from None
    return lines
