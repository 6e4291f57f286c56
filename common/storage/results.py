"""Results on disk: one summary (JSON) and the raw trials (JSON Lines)."""

import json
import os
from collections.abc import Mapping
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np

from common.domain.case import Case
from common.domain.parameter import differences
from common.domain.trial import Result
from common.tasks import TASKS


def summarize(result: Result, *, case: Case, settings: Mapping[str, Any]) -> dict[str, Any]:
    """Return what a program wants to know of a result, ready for JSON.

    ``action_error_m`` is the distance to the true action; None where another item made the target, or nobody knows it.
    ``other_errors`` holds the errors of parameters that are no lengths, ``yaw_error_rad`` for instance.
    """
    return {
        "case": case.name,
        "action": list(result.action),
        "true_action": None if case.true_action is None else list(case.true_action),
        "same_item": case.same_item,
        "action_error_m": action_error(result, case),
        "other_errors": other_errors(result, case),
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
    """Return the Euclidean distance between best and true action [m], as in the paper; None if it means nothing.

    It is taken over the parameters that are lengths; `other_errors` has the others.
    """
    lengths = [gap for gap, unit in _gaps(result, case).values() if unit == "m"]
    return float(np.linalg.norm(lengths)) if lengths else None


def other_errors(result: Result, case: Case) -> dict[str, float]:
    """Return ``<parameter>_error_<unit>`` for parameters that are no lengths, the short way round where they turn."""
    return {f"{name}_error_{unit}": abs(gap) for name, (gap, unit) in _gaps(result, case).items() if unit != "m"}


def _gaps(result: Result, case: Case) -> dict[str, tuple[float, str]]:
    """Return by parameter how far the answer is from the true action, and the unit; nothing if that means nothing."""
    if case.reference_action is None:
        return {}
    parameters = TASKS[case.task].parameters
    gaps = differences(parameters, np.array(result.action), np.array(case.reference_action))
    return {p.name: (float(gap), p.unit) for p, gap in zip(parameters, gaps, strict=True)}


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
