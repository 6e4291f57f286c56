"""What the raw results of strategies say: a row each, with bootstrap intervals and paired differences."""

from collections import defaultdict
from collections.abc import Callable, Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pipelines.evaluate.strategies import REFERENCE
from pipelines.evaluate.threshold_table import stopped

Record = Mapping[str, Any]

RESAMPLES = 2000
BUDGETS = (3, 6, 12)
"""Calls at which the simulator alone is stopped, for comparison."""


def strategies_table(records: Sequence[Record]) -> list[dict[str, Any]]:
    """Return a row per method over the targets that every method has done; SI units.

    Every figure is ``{value, low, high, difference, difference_low, difference_high}``: 95% intervals by resampling
    targets, and the paired difference to the simulator alone. Action errors are those of targets made with the own
    item; a regret is measured from the best true reward of any method. ``wall_s`` is the processor's time, the
    same as the wall time of one evaluation at a time on an idle machine; ``counted_s`` counts only calls, each at what
    a step of the reference took on the same target.
    """
    rows = _paired(records)
    targets = sorted(rows[REFERENCE])
    best = {target: max(found[target]["true_reward"] for found in rows.values()) for target in targets}
    cost = {target: _call_s(rows[REFERENCE][target]) for target in targets}
    measures = {name: _measures(found, targets, best, cost) for name, found in rows.items()}
    reference = measures[REFERENCE]
    return [
        {"strategy": name, "targets": len(targets)}
        | {
            figure: _figure(statistic, found[measure], reference[measure])
            for figure, (measure, statistic) in FIGURES.items()
        }
        | {"time_ratio": _figure(_mean, found["wall_s"] / reference["wall_s"].mean(), None)}
        for name, found in measures.items()
    ]


def _paired(records: Sequence[Record]) -> dict[str, dict[int, Record]]:
    by_method: defaultdict[str, dict[int, Record]] = defaultdict(dict)
    for record in records:
        by_method[record["method"]][record["target"]] = record
    shared = set.intersection(*(set(found) for found in by_method.values()))
    rows: dict[str, dict[int, Record]] = {
        name: {target: found[target] for target in shared} for name, found in by_method.items()
    }
    for calls in BUDGETS:
        rows[f"{REFERENCE}, {calls} calls"] = {
            target: _stopped(record, calls) for target, record in rows[REFERENCE].items()
        }
    return rows


def _stopped(record: Record, calls: int) -> Record:
    share = min(calls / len(record["trials"]), 1.0)
    return {**stopped(record, calls), "process_s": share * record["process_s"]}


def _call_s(reference: Record) -> float:
    """Return what one simulator call and one step around it took in the reference [s]."""
    return reference["process_s"] / len(reference["trials"])


def _measures(
    rows: Mapping[int, Record], targets: Sequence[int], best: Mapping[int, float], cost: Mapping[int, float]
) -> dict[str, NDArray[np.float64]]:
    """Return a value per target; NaN where a target does not have one."""
    found: defaultdict[str, list[float]] = defaultdict(list)
    for target in targets:
        row, nan = rows[target], float("nan")
        error = row["action_error_m"]
        calls = row["usage"].get("simulator", 0)
        regret = best[target] - row["true_reward"]
        found["error_m"].append(nan if error is None else error)
        found["regret_m"].append(regret)
        found["regret_other_m"].append(nan if row["same_item"] else regret)
        found["calls"].append(calls)
        found["wall_s"].append(row["process_s"])
        found["counted_s"].append(calls * cost[target])
    return {name: np.array(values) for name, values in found.items()}


def _mean(values: NDArray[np.float64]) -> NDArray[np.float64]:
    return np.mean(values, axis=-1)


def _median(values: NDArray[np.float64]) -> NDArray[np.float64]:
    return np.median(values, axis=-1)


Statistic = Callable[[NDArray[np.float64]], NDArray[np.float64]]

FIGURES: dict[str, tuple[str, Statistic]] = {
    "error_mean_m": ("error_m", _mean),
    "error_median_m": ("error_m", _median),
    "reward_regret_m": ("regret_m", _mean),
    "reward_regret_other_m": ("regret_other_m", _mean),
    "simulator_calls": ("calls", _mean),
    "wall_s": ("wall_s", _mean),
    "counted_s": ("counted_s", _mean),
}
"""Figure -> (measure, statistic)."""


def _figure(
    statistic: Statistic,
    values: NDArray[np.float64],
    reference: NDArray[np.float64] | None,
) -> dict[str, float]:
    known = ~np.isnan(values)
    values = values[known]
    draws = np.random.default_rng(0).integers(len(values), size=(RESAMPLES, len(values)))
    low, high = np.percentile(statistic(values[draws]), (2.5, 97.5))
    figure = {"value": float(statistic(values)), "low": float(low), "high": float(high)}
    if reference is not None:
        reference = reference[known]
        differences = statistic(values[draws]) - statistic(reference[draws])
        low, high = np.percentile(differences, (2.5, 97.5))
        difference = float(statistic(values) - statistic(reference))
        figure |= {"difference": difference, "difference_low": float(low), "difference_high": float(high)}
    return figure
