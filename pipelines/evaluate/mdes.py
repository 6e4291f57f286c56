"""Table II, first row, from raw judgements: how good the MDEs are, by model and variant."""

from collections import defaultdict
from collections.abc import Iterable, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pipelines.evaluate.mdes_runs import Run
from pipelines.mde.scores import acceptance, coverage, mean_absolute_error, spearman

THRESHOLDS = (0.1, 0.2, 0.3, 0.4)
"""Other values of d_max that are told of."""


def mdes_table(runs: Iterable[Run]) -> dict[str, dict[str, dict[str, Any]]]:
    """Return figures by model and variant, means over the seeds.

    Of each network there are two variants: its estimate, and ``<network>_upper``, its calibrated upper bound in place
    of the estimate. Times are in seconds, deviations scaled to [0, 1].
    """
    by_subject: defaultdict[tuple[str, str], list[Run]] = defaultdict(list)
    for run in runs:
        by_subject[run.judgements[0].model, run.judgements[0].variant].append(run)
    table: defaultdict[str, dict[str, dict[str, Any]]] = defaultdict(dict)
    for (model, variant), same in sorted(by_subject.items()):
        table[model][variant] = _entry(same, by="mean")
        table[model][f"{variant}_upper"] = _entry(same, by="upper")
    return dict(table)


def _entry(runs: Sequence[Run], *, by: str) -> dict[str, Any]:
    rows = [_figures(run, by=by) for run in runs]
    maes = [row["mae"] for row in rows]
    entry: dict[str, Any] = {name: _mean([row[name] for row in rows]) for name in rows[0] if name != "at"}
    entry["mae_std"] = float(np.std(maes, ddof=1)) if len(maes) > 1 else None
    entry["seeds"] = [run.judgements[0].seed for run in runs]
    entry["samples"] = len(runs[0].judgements)
    entry["scale_m"] = runs[0].scale_m
    entry["at"] = {
        f"{d_max:g}": {name: _mean([row["at"][d_max][name] for row in rows]) for name in rows[0]["at"][d_max]}
        for d_max in THRESHOLDS
    }
    return entry


def _figures(run: Run, *, by: str) -> dict[str, Any]:
    truth, estimates = column(run, "truth"), column(run, by)
    accepted = vars(acceptance(truth, estimates, d_max=run.d_max))
    return {
        "mae": mean_absolute_error(truth, estimates),
        "median_baseline_mae": mean_absolute_error(truth, np.full_like(truth, run.median_of_training)),
        "spearman": spearman(truth, estimates),
        **accepted,
        "coverage": coverage(truth, column(run, "upper")),
        "nominal_coverage": run.nominal_coverage,
        "unfamiliar_share": 1 - float(column(run, "familiar").mean()),
        "action_s": run.action_s,
        "state_s": run.state_s,
        "at": {d_max: vars(acceptance(truth, estimates, d_max=d_max)) for d_max in THRESHOLDS},
    }


def column(run: Run, name: str) -> NDArray[np.float64]:
    """Return one field of all judgements ``(M,)``."""
    return np.array([getattr(judgement, name) for judgement in run.judgements], dtype=np.float64)


def _mean(values: Sequence[float | None]) -> float | None:
    known = [value for value in values if value is not None]
    return float(np.mean(known)) if known else None
