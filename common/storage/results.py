"""Results on disk: one summary (JSON) and the raw trials (JSON Lines)."""

import json
import os
from collections.abc import Mapping
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np

from common.domain.case import Case
from common.domain.trial import Result


def summarize(result: Result, *, case: Case, settings: Mapping[str, Any]) -> dict[str, Any]:
    """Return what a program wants to know of a result, ready for JSON.

    ``action_error_m`` is the distance to the true action; None where another item made the target, or nobody knows it.
    """
    return {
        "case": case.name,
        "action": list(result.action),
        "true_action": None if case.true_action is None else list(case.true_action),
        "same_item": case.same_item,
        "action_error_m": action_error(result, case),
        "reward": result.reward,
        "evaluations": len(result.trials),
        "usage": result.usage,
        "models": result.models,
        "strategy": result.strategy,
        "seed": result.seed,
        "in_flight": result.in_flight,
        "certificate": None if result.certificate is None else asdict(result.certificate),
        "wall_s": result.wall_s,
        "split_s": result.split_s,
        "events": [asdict(event) for event in result.events],
        "settings": dict(settings),
    }


def action_error(result: Result, case: Case) -> float | None:
    """Return the Euclidean distance between best and true action [m], as in the paper; None if it means nothing."""
    if case.reference_action is None:
        return None
    return float(np.linalg.norm(np.subtract(result.action, case.reference_action)))


def write_result(folder: Path, result: Result, *, case: Case, settings: Mapping[str, Any]) -> None:
    """Write ``result.json`` and ``trials.jsonl`` into ``folder``; each appears whole or not at all."""
    folder.mkdir(parents=True, exist_ok=True)
    trials = "".join(json.dumps(asdict(trial)) + "\n" for trial in result.trials)
    _write(folder / "trials.jsonl", trials)
    _write(folder / "result.json", json.dumps(summarize(result, case=case, settings=settings), indent=2) + "\n")


def _write(path: Path, text: str) -> None:
    unfinished = path.with_name(f".{path.name}.{os.getpid()}")
    unfinished.write_text(text)
    unfinished.replace(path)
