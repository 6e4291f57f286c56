"""What the raw results of strategies say: a row each, with bootstrap intervals and paired differences."""

from collections import Counter, defaultdict
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from pipelines.evaluate.strategies_controls import CONTROLS
from pipelines.evaluate.strategies_methods import reference
from pipelines.evaluate.strategies_statistics import Statistic, Values, compared, figure, mean, median
from pipelines.evaluate.threshold import TRUSTED
from pipelines.evaluate.threshold_table import stopped

Record = Mapping[str, Any]
Found = Mapping[int, Record]

BUDGETS = (2, 3, 4, 6, 12, 25)
"""Calls at which the trusted model alone, and BoTorch's loops, are stopped for comparison."""
STOPPABLE = ("botorch:ucb", "botorch:logei")
"""Loops that do not know their budget."""
FIGURES: dict[str, tuple[str, Statistic]] = {
    "error_mean_m": ("error_m", mean),
    "error_median_m": ("error_m", median),
    "reward_regret_m": ("regret_m", mean),
    "reward_regret_same_m": ("regret_same_m", mean),
    "reward_regret_other_m": ("regret_other_m", mean),
    "jitter_reward_m": ("jitter_m", mean),
    "jitter_reward_other_m": ("jitter_other_m", mean),
    "simulator_calls": ("calls", mean),
    "wall_s": ("wall_s", mean),
    "processor_s": ("processor_s", mean),
    "counted_s": ("counted_s", mean),
}
"""Figure -> (measure, statistic)."""
FAMILIES = {"fast": "transport", "balanced": "transport", "quality": "transport"}
"""Strategies that are others with a budget."""


def strategies_table(records: Sequence[Record], *, trusted: str = TRUSTED) -> list[dict[str, Any]]:
    """Return a row per method over the targets that every method has done; SI units.

    Every figure is ``{value, low, high, difference, difference_low, difference_high, ratio, ratio_low, ratio_high}``:
    95% intervals by resampling targets, and paired difference and ratio to the reference, the trusted model alone.

    - ``error_*``: action errors of targets made with the own item.
    - ``reward_regret*``: from the best true reward that any method has found on the target.
    - ``jitter_reward*``: expected true reward under the execution errors of `Comparison`; higher is better.
    - ``simulator_calls``: calls of the trusted model.
    - ``wall_s``, ``processor_s``: what one optimisation took by either clock, each method as if it had been alone;
      ``split_s`` has the wall time's parts.
    - ``counted_s``: only calls of the trusted model, each at what a step of the reference took on the same target.
    - ``certificate``: how many targets have one, how many of them are violated, and how many may be.

    ``against`` holds the same differences and ratios to others: ``stopped``, the reference stopped at as many calls on
    each target, the cheapest model with the same polish, the same method with other MDEs or one evaluation in flight,
    and `threshold`.
    """
    alone = reference(trusted)
    rows, failed = _paired(records, alone)
    if alone not in rows:
        return []
    targets = sorted(rows[alone])
    best = _best_rewards(rows, targets)
    cost = {target: rows[alone][target]["process_s"] / len(rows[alone][target]["trials"]) for target in targets}
    measures = {name: _measures(found, targets, best, cost) for name, found in rows.items()}
    table = []
    for name, found in rows.items():
        others = {other: measures[other] for other in _others(name, rows, alone)}
        calls = {target: int(record["calls"]) for target, record in found.items()}
        if name != alone and any(calls.values()):
            same = {target: _stopped(rows[alone][target], count) for target, count in calls.items()}
            others["stopped"] = _measures(same, targets, best, cost)
        table.append(
            {
                **_described(name, found[targets[0]], alone),
                "targets": len(targets),
                "failed": failed[name],
                **{
                    each: figure(statistic, measures[name][measure])
                    | compared(statistic, measures[name][measure], measures[alone][measure])
                    for each, (measure, statistic) in FIGURES.items()
                },
                "split_s": _split(found),
                "certificate": _certified(found, best),
                "against": {other: _compared(measures[name], values) for other, values in others.items()},
            }
        )
    return table


def _paired(records: Sequence[Record], alone: str) -> tuple[dict[str, Found], Counter[str]]:
    """Return the records by method and target, of targets that all have done, and how many each has failed at."""
    by_method: defaultdict[str, dict[int, Record]] = defaultdict(dict)
    failed = Counter[str]()
    for record in records:
        if "error" in record:
            failed[record["method"]] += 1
        else:
            by_method[record["method"]][record["target"]] = record
    shared = set.intersection(*(set(found) for found in by_method.values())) if by_method else set[int]()
    if not shared:
        return {}, failed
    rows: dict[str, Found] = {}
    for name, found in by_method.items():
        rows[name] = {target: found[target] for target in shared}
        if name in (alone, *STOPPABLE):
            for calls in BUDGETS:
                if calls < min(len(record["trials"]) for record in rows[name].values()):
                    rows[f"{name}, {calls} calls"] = {
                        target: _stopped(record, calls) for target, record in rows[name].items()
                    }
    return rows, failed


def _stopped(record: Record, calls: int) -> Record:
    """Return what a method that takes one call after the other would have answered after a number of them."""
    found = stopped(record, calls)
    count = len(found["trials"])
    return {
        **found,
        "process_s": record["process_s"] * min(found["wall_s"] / record["wall_s"], 1.0),
        "calls": count,
        "budget": count,
        "jitter_reward": None,
        "certificate": None,
    }


def _best_rewards(rows: Mapping[str, Found], targets: Sequence[int]) -> dict[int, float]:
    return {
        target: max(
            (found[target]["true_reward"] for found in rows.values() if found[target]["true_reward"] is not None),
            default=float("nan"),
        )
        for target in targets
    }


def _measures(
    rows: Found, targets: Sequence[int], best: Mapping[int, float], cost: Mapping[int, float]
) -> dict[str, Values]:
    """Return a value per target; NaN where a target does not have one."""
    found: defaultdict[str, list[float]] = defaultdict(list)
    nan = float("nan")
    for target in targets:
        row = rows[target]
        regret = nan if row["true_reward"] is None else best[target] - row["true_reward"]
        jitter = nan if row["jitter_reward"] is None else row["jitter_reward"]
        found["error_m"].append(nan if row["action_error_m"] is None else row["action_error_m"])
        found["regret_m"].append(regret)
        found["regret_same_m"].append(regret if row["same_item"] else nan)
        found["regret_other_m"].append(nan if row["same_item"] else regret)
        found["jitter_m"].append(jitter)
        found["jitter_other_m"].append(nan if row["same_item"] else jitter)
        found["calls"].append(row["calls"])
        found["wall_s"].append(row["wall_s"])
        found["processor_s"].append(row["process_s"])
        found["counted_s"].append(row["calls"] * cost[target])
    return {name: np.array(values, dtype=np.float64) for name, values in found.items()}


def _others(name: str, rows: Mapping[str, Found], alone: str) -> list[str]:
    """Return the methods that one is compared with, besides the reference."""
    strategy, *options = name.split("+")
    others = [f"{strategy}+{control}" for control in CONTROLS] if not options else [strategy]
    flying = [option for option in options if option.endswith("-in-flight")]
    others += [f"{alone}+{option}" for option in flying]
    budget = next(iter(rows[name].values()))["budget"]
    others += [f"polish:calls={budget}", "threshold"]
    return [other for other in dict.fromkeys(others) if other in rows and other != name]


def _described(name: str, record: Record, alone: str) -> dict[str, Any]:
    strategy, *options = name.partition(",")[0].split("+")
    family = "reference" if strategy == alone else strategy.partition(":calls")[0]
    return {
        "strategy": name,
        "family": FAMILIES.get(family, family),
        "options": options,
        "budget": record["budget"],
        "d_max": record["d_max"],
    }


def _compared(values: Mapping[str, Values], others: Mapping[str, Values]) -> dict[str, Any]:
    return {
        each: compared(statistic, values[measure], others[measure]) for each, (measure, statistic) in FIGURES.items()
    }


def _split(found: Found) -> dict[str, float]:
    """Return the parts of the wall time [s]."""
    total = Counter[str]()
    for record in found.values():
        total.update(record["split_s"])
    return {name: seconds / len(found) for name, seconds in sorted(total.items())}


def _certified(found: Found, best: Mapping[int, float]) -> dict[str, Any] | None:
    """Return the share of targets where a method's answer is better by more than the certified gain; and the stated."""
    known = {target: record for target, record in found.items() if record["true_reward"] is not None}
    certified = {target: record for target, record in known.items() if record["certificate"]}
    if not certified:
        return None
    violated = [
        best[target] - record["true_reward"] > record["certificate"]["gain"] for target, record in certified.items()
    ]
    return {
        "targets": len(certified),
        "violated": float(np.mean(violated)),
        "stated": float(np.mean([1 - record["certificate"]["probability"] for record in certified.values()])),
        "gain_m": float(np.mean([record["certificate"]["gain"] for record in certified.values()])),
    }
