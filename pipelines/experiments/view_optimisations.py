"""Errors, times and usage of methods that optimised the same targets."""

from collections import Counter
from collections.abc import Callable, Mapping, Sequence

import numpy as np

from common.domain.errors import RequestError
from pipelines.experiments.draw_bars import draw_error_and_time, draw_usage
from pipelines.experiments.experiment import Experiment, Series
from pipelines.experiments.numbers import Number, number
from pipelines.experiments.raw import Raw, Row
from pipelines.experiments.shown import Shown
from pipelines.experiments.statistics import Estimate, Sample

MM = 1000.0
Found = Mapping[str, Sequence[Row]]
"""Rows of the targets that every method has done, by the key of the series, in the order of the targets."""


def error_and_time(experiment: Experiment, results: Mapping[str, Raw]) -> Shown:
    """Return for each series what it achieves and what it takes.

    ``<key>.error`` and ``.median`` are mean and median of the action error, the distance from the true action;
    ``.time`` and ``.processor`` the mean wall and processor time of one optimisation; ``.calls`` the calls of the
    trusted model.
    ``.error_ratio`` and ``.time_ratio`` are paired ratios of means to the trusted model alone, times to its own run in
    the same measurement where there is one. ``.change`` and ``.calls_change`` are paired differences to the series
    before.
    """
    found, trusted = paired(experiment, results), _trusted(results)
    alone = next((one.key for one in experiment.series if one.method == f"only:{trusted}"), None)
    numbers: list[Number] = []
    for series in experiment.series:
        rows, made = found[series.key], _Maker(experiment, series, results, len(found[series.key]))
        errors, times = MM * _column(rows, "action_error_m"), _column(rows, "wall_s")
        numbers += [
            made("error", "action error, mean", made.sample.mean(errors), "mm", std=float(np.std(errors))),
            made("median", "action error, median", made.sample.median(errors), "mm"),
            made("time", "time", made.sample.mean(times), "s", std=float(np.std(times))),
            made("processor", "processor time", made.sample.mean(_column(rows, "process_s")), "s"),
            made("calls", f"calls of {trusted}", made.sample.mean(_column(rows, "calls")), ""),
        ]
        if alone not in (None, series.key):
            others = found[alone]
            error = made.sample.ratio(errors, MM * _column(others, "action_error_m"))
            own = _alone(results, series, f"only:{trusted}")
            beside = [own[row["target"]] for row in rows] if own else others
            time = made.sample.ratio(times, _column(beside, "wall_s"))
            numbers += [
                made("error_ratio", f"error over only:{trusted}'s", error, ""),
                made("time_ratio", f"time over only:{trusted}'s", time, ""),
            ]
        if series.before:
            label = next(one.label for one in experiment.series if one.key == series.before)
            earlier = found[series.before]
            change = made.sample.difference(errors, MM * _column(earlier, "action_error_m"))
            calls = made.sample.difference(_column(rows, "calls"), _column(earlier, "calls"))
            numbers += [
                made("change", f"error minus that of {label}, paired", change, "mm"),
                made("calls_change", f"calls minus those of {label}, paired", calls, ""),
            ]
    return Shown(tuple(numbers), draw_error_and_time(experiment, numbers))


def usage(experiment: Experiment, results: Mapping[str, Raw]) -> Shown:
    """Return ``<key>.<model>``, how many of a method's evaluated actions the model predicted, mean over the targets.

    What strategies ask cheap models in sweeps before they evaluate an action is ``<key>.swept``, and no bar.
    """
    found = paired(experiment, results)
    family = next(iter(results.values())).header["parameters"]["family"]
    numbers: list[Number] = []
    for series in experiment.series:
        rows, made = found[series.key], _Maker(experiment, series, results, len(found[series.key]))
        counts = [Counter(trial["model"] for trial in row["trials"] if not trial["error"]) for row in rows]
        for model in family:
            mean = made.sample.mean(np.array([count[model] for count in counts], dtype=np.float64))
            numbers.append(made(model, model, mean, ""))
        swept = np.array([sum(row["usage"].values()) - count.total() for row, count in zip(rows, counts, strict=True)])
        if swept.any():
            numbers.append(made("swept", "in sweeps", made.sample.mean(swept.astype(np.float64)), ""))
    return Shown(tuple(numbers), draw_usage(experiment, numbers, family))


def paired(experiment: Experiment, results: Mapping[str, Raw]) -> Found:
    """Return the rows of every series, of the targets that no method has failed at.

    Raises:
        RequestError: A series has no raw results, or there is no such target.
    """
    found: dict[str, dict[int, Row]] = {}
    for series in experiment.series:
        raw = results[series.measurement or next(iter(results))]
        rows = [row for row in raw.rows if row["method"] == series.method]
        if not rows:
            raise RequestError(f"{experiment.name}: expected raw results of {series.method}, got none")
        found[series.key] = {row["target"]: row for row in rows if "error" not in row}
    shared = sorted(set.intersection(*(set(rows) for rows in found.values())))
    if not shared:
        raise RequestError(f"{experiment.name}: expected a target that every method has done, got none")
    return {key: [rows[target] for target in shared] for key, rows in found.items()}


def _alone(results: Mapping[str, Raw], series: Series, method: str) -> dict[int, Row]:
    """Return what the trusted model alone did in a series' measurement, by target; nothing if it did not take part."""
    raw = results[series.measurement or next(iter(results))]
    return {row["target"]: row for row in raw.rows if row["method"] == method and "error" not in row}


class _Maker:
    """Makes the numbers of one series."""

    def __init__(self, experiment: Experiment, series: Series, results: Mapping[str, Raw], targets: int) -> None:
        self.sample = Sample(np.arange(targets))
        self._series = series
        header = results[series.measurement or next(iter(results))].header
        self._make: Callable[..., Number] = lambda *parts, **options: number(
            experiment, *parts, seeds=header["seeds"], samples=targets, **options
        )

    def __call__(self, part: str, label: str, found: Estimate, unit: str, *, std: float | None = None) -> Number:
        """Return ``<key>.<part>``."""
        return self._make(f"{self._series.key}.{part}", (self._series.label, label), found, unit, std=std)


def _trusted(results: Mapping[str, Raw]) -> str:
    return next(iter(results.values())).header["parameters"]["family"][-1]


def _column(rows: Sequence[Row], name: str) -> np.ndarray:
    return np.array([row[name] for row in rows], dtype=np.float64)
