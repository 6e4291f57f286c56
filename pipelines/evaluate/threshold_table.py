"""What the raw results of `threshold` against the simulator alone say."""

from collections import Counter, defaultdict
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

Record = Mapping[str, Any]

REFERENCE = "only:simulator"


def threshold_table(records: Sequence[Record]) -> dict[str, dict[str, Any]]:
    """Return figures by method, over all targets that every method has done; SI units.

    Beside each threshold stands ``<method>, calls``: the simulator alone, stopped at as many calls on each target as
    that method made. The best known reward of a target is the best true one of any method.
    """
    by_method: defaultdict[str, dict[int, Record]] = defaultdict(dict)
    for record in records:
        by_method[record["method"]][record["target"]] = record
    shared = sorted(set.intersection(*(set(found) for found in by_method.values()))) if by_method else []
    table: dict[str, list[Record]] = {}
    for method, found in by_method.items():
        table[method] = [found[target] for target in shared]
        if method.startswith("threshold") and REFERENCE in by_method:
            table[f"{method}, calls"] = [
                stopped(by_method[REFERENCE][target], found[target]["usage"].get("simulator", 0)) for target in shared
            ]
    best = {target: max(rows[place]["true_reward"] for rows in table.values()) for place, target in enumerate(shared)}
    reference = table.get(REFERENCE)
    return {method: _figures(rows, best, reference) for method, rows in table.items()}


def stopped(record: Record, calls: int) -> dict[str, Any]:
    """Return what the simulator alone would have answered after a number of calls, one at least.

    Its actions do not depend on how many will follow.
    """
    trials = record["trials"][: max(calls, 1)]
    rewarded = [trial for trial in trials if trial["reward"] is not None] or [record["trials"][0]]
    best = max(rewarded, key=lambda trial: trial["reward"] if trial["reward"] is not None else -np.inf)
    error = None
    if record["action_error_m"] is not None:
        error = float(np.linalg.norm(np.subtract(best["action"], record["true_action"])))
    share = len(trials) / len(record["trials"])
    compute_s = sum(trial["compute_s"] for trial in trials)
    return {
        **record,
        "action": best["action"],
        "action_error_m": error,
        "true_reward": best["reward"],
        "usage": {"simulator": len(trials)},
        "wall_s": trials[-1]["started_s"] + trials[-1]["predict_s"],
        "split_s": {**{name: share * s for name, s in record["split_s"].items()}, "simulator": compute_s},
        "trials": trials,
    }


def _figures(rows: Sequence[Record], best: Mapping[int, float], reference: Sequence[Record] | None) -> dict[str, Any]:
    same = [row for row in rows if row["same_item"]]
    other = [row for row in rows if not row["same_item"]]
    usage = Counter[str]()
    split = Counter[str]()
    for row in rows:
        usage.update(row["usage"])
        split.update(row["split_s"])
    evaluations = sum(usage.values())
    wall_s = float(np.mean([row["wall_s"] for row in rows])) if rows else None
    reference_s = float(np.mean([row["wall_s"] for row in reference])) if reference else None
    return {
        "targets": len(rows),
        "same_item_targets": len(same),
        "action_error_m": _spread([row["action_error_m"] for row in same]),
        "true_reward_m": _spread([row["true_reward"] for row in rows], tail=10),
        "regret_same_item_m": _spread([best[row["target"]] - row["true_reward"] for row in same]),
        "regret_other_item_m": _spread([best[row["target"]] - row["true_reward"] for row in other]),
        "simulator_calls": usage["simulator"] / max(len(rows), 1),
        "shares": {model: count / max(evaluations, 1) for model, count in sorted(usage.items())},
        "wall_s": wall_s,
        "time_ratio": None if not wall_s or not reference_s else wall_s / reference_s,
        "split_s": {name: seconds / max(len(rows), 1) for name, seconds in sorted(split.items())},
        "unfamiliar_share": sum(row["unfamiliar"] for row in rows) / max(sum(len(row["trials"]) for row in rows), 1),
    }


def _spread(values: Sequence[float], *, tail: int = 90) -> dict[str, float] | None:
    """Return mean, median and the percentile at the bad end."""
    if not values:
        return None
    mean, median, bad = np.mean(values), np.median(values), np.percentile(values, tail)
    return {"mean": float(mean), "median": float(median), f"p{tail}": float(bad)}
