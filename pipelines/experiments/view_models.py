"""Table I: the models' errors, with ratios to the heuristic's and times."""

from collections.abc import Mapping, Sequence

import numpy as np

from pipelines.experiments.experiment import Experiment
from pipelines.experiments.numbers import Number, number
from pipelines.experiments.raw import Raw, Row
from pipelines.experiments.shown import Shown
from pipelines.experiments.statistics import Estimate, Sample

SETS = {"sim": "simulated", "real": "stand-in for the real world"}
"""Name of a measurement -> what a reader sees."""
CM, MS = 100.0, 1000.0


def model_errors(experiment: Experiment, results: Mapping[str, Raw]) -> Shown:
    """Return for each set of cases ``<set>.<model>``, the mean RMSE with its standard deviation over the samples.

    ``ratio.<set>.<model>`` is the ratio to the heuristic on the same samples, ``time.<model>`` the median time of one
    prediction in the first set, ``time.<model>_soft`` and ``_rigid`` that of all sets by the item.
    """
    found: list[Number] = []
    for name, raw in results.items():
        found += _errors(experiment, name, raw)
    for name, raw in results.items():
        found += _ratios(experiment, name, raw)
    return Shown((*found, *_times(experiment, results)))


def _errors(experiment: Experiment, name: str, raw: Raw) -> list[Number]:
    numbers: list[Number] = []
    for model, rows in _by_model(raw.rows).items():
        errors, sample = CM * _column(rows, "rmse_m"), Sample(_column(rows, "group").astype(int))
        at = f"RMSE, {SETS.get(name, name)}", model
        numbers.append(_number(experiment, f"{name}.{model}", at, sample.mean(errors), "cm", raw, errors))
    return numbers


def _ratios(experiment: Experiment, name: str, raw: Raw) -> list[Number]:
    by_model, numbers = _by_model(raw.rows), list[Number]()
    heuristic = {row["sample"]: row["rmse_m"] for row in by_model.get("heuristic", [])}
    for model, rows in by_model.items():
        if model == "heuristic" or not all(row["sample"] in heuristic for row in rows):
            continue
        own, sample = _column(rows, "rmse_m"), Sample(_column(rows, "group").astype(int))
        ratio = sample.ratio(own, np.array([heuristic[row["sample"]] for row in rows]))
        at = f"over the heuristic's, {SETS.get(name, name)}", model
        numbers.append(_number(experiment, f"ratio.{name}.{model}", at, ratio, "", raw, own, spread=False))
    return numbers


def _times(experiment: Experiment, results: Mapping[str, Raw]) -> list[Number]:
    """Return the times of the models; of simulators by the item, as soft ones take longer."""
    numbers, raw = list[Number](), next(iter(results.values()))
    every = [row for one in results.values() for row in one.rows]
    for model, rows in _by_model(every).items():
        kinds = {f"{model}_soft": False, f"{model}_rigid": True} if model.startswith("simulator") else {model: None}
        for key, rigid in kinds.items():
            own = [row for row in rows if rigid is None or row["rigid"] == rigid]
            if own:
                times = MS * _column(own, "time_s")
                median = Sample(np.arange(len(own))).median(times)
                kind = {None: "", False: ", soft item", True: ", rigid item"}[rigid]
                at = f"time of a prediction{kind}, median", model
                numbers.append(_number(experiment, f"time.{key}", at, median, "ms", raw, times, spread=False))
    return numbers


def _number(
    experiment: Experiment,
    key: str,
    at: tuple[str, str],
    found: Estimate,
    unit: str,
    raw: Raw,
    values: Sequence[float] | np.ndarray,
    *,
    spread: bool = True,
) -> Number:
    std = float(np.std(values)) if spread else None
    seeds, count = raw.header["seeds"], len(values)
    return number(experiment, key, at, found, unit, seeds=seeds, samples=count, std=std)


def _by_model(rows: Sequence[Row]) -> dict[str, list[Row]]:
    return {
        model: [row for row in rows if row["model"] == model] for model in dict.fromkeys(row["model"] for row in rows)
    }  # fmt: skip


def _column(rows: Sequence[Row], name: str) -> np.ndarray:
    return np.array([row[name] for row in rows], dtype=np.float64)
