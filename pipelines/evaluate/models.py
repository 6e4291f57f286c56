"""Table I from raw measurements: how far each model is from the trusted outcome."""

from collections.abc import Callable, Iterable, Sequence
from typing import Any

import numpy as np

from pipelines.evaluate.models_runs import Latency, Measurement
from pipelines.evaluate.regions import REGIONS

PARTS: dict[str, Callable[[Measurement], bool]] = {
    **{name: lambda row, name=name: row.region == name for name in REGIONS},
    "soft": lambda row: not row.rigid,
    "rigid": lambda row: row.rigid,
}
"""Parts of the test samples that are told of: by region, then by material."""


def models_table(rows: Iterable[Measurement | Latency]) -> dict[str, dict[str, Any]]:
    """Return figures by model: mean and spread of the samples' RMSE [m], over all and by part, and times [s].

    ``ratio`` is a model's mean over the heuristic's on the same samples, None where there are none.
    """
    found = tuple(rows)
    measured = [row for row in found if isinstance(row, Measurement)]
    times = {row.model: row for row in found if isinstance(row, Latency)}
    heuristic = {row.sample: row.rmse_m for row in measured if row.model == "heuristic"}
    table: dict[str, dict[str, Any]] = {}
    for model in dict.fromkeys(row.model for row in measured):
        own = [row for row in measured if row.model == model]
        alone = [row.time_s for row in own if row.time_s is not None]
        latency = times.get(model) or Latency(model, 1, tuple(alone))
        table[model] = {
            "version": own[0].version,
            "reference": own[0].reference,
            **_figures(own, heuristic),
            "latency_p50_s": _percentile(latency.times_s, 50),
            "latency_p95_s": _percentile(latency.times_s, 95),
            "latency_batch": latency.batch,
            "parts": {
                name: _figures([row for row in own if belongs(row)], heuristic) for name, belongs in PARTS.items()
            },
        }
    return table


def _figures(rows: Sequence[Measurement], heuristic: dict[int, float]) -> dict[str, Any]:
    errors = [row.rmse_m for row in rows]
    same = [heuristic[row.sample] for row in rows if row.sample in heuristic]
    is_comparable = bool(rows) and len(same) == len(rows)
    return {
        "rmse_m": float(np.mean(errors)) if errors else None,
        "rmse_std_m": float(np.std(errors)) if errors else None,
        "rmse_median_m": float(np.median(errors)) if errors else None,
        "samples": len(errors),
        "ratio": float(np.mean(errors) / np.mean(same)) if is_comparable else None,
    }


def _percentile(times_s: Sequence[float], percent: float) -> float | None:
    return float(np.percentile(times_s, percent)) if times_s else None
