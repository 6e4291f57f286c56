"""Errors of MDEs over the number of trials that they were trained with, and differences between two ways."""

from collections.abc import Mapping, Sequence
from dataclasses import replace

from common.domain.errors import RequestError
from pipelines.experiments.draw_curves import draw_curves
from pipelines.experiments.experiment import Experiment
from pipelines.experiments.judged import Judged
from pipelines.experiments.numbers import Number, number
from pipelines.experiments.raw import Raw
from pipelines.experiments.shown import Shown
from pipelines.experiments.statistics import Sample
from pipelines.experiments.view_mdes import UNIT


def learning_curves(experiment: Experiment, results: Mapping[str, Raw]) -> Shown:
    """Return ``<key>.<trials>``, the mean absolute error on the test trials over samples and seeds, for each series.

    ``difference.<key>.<trials>`` is the first series minus that one, paired by seed and sample. ``reached.<key>`` is
    the fewest trials with which it is as good as the first series with its most.

    Raises:
        RequestError: A series has no raw results.
    """
    numbers: list[Number] = []
    first: dict[int, Judged] = {}
    differences: list[Number] = []
    for place, series in enumerate(experiment.series):
        raw = results[series.measurement or next(iter(results))]
        own = [row for row in raw.rows if row["method"] == series.method]
        if not own:
            raise RequestError(f"{experiment.name}: expected raw results of {series.method}, got none")
        for trials in sorted({row["trials"] for row in own}):
            judged = Judged.of([row for row in own if row["trials"] == trials])
            sample = Sample(judged.groups, seeds=len(judged.seeds))
            about = {"seeds": judged.seeds, "samples": len(judged.groups)}
            column = f"{trials} trials"
            numbers.append(
                number(
                    experiment,
                    f"{series.key}.{trials}",
                    (series.label, column),
                    sample.mean(judged.errors),
                    UNIT,
                    **about,
                )
            )
            if place == 0:
                first[trials] = judged
            elif trials in first and first[trials].seeds == judged.seeds:
                change = sample.difference(first[trials].errors, judged.errors)
                row = f"{experiment.series[0].label} minus {series.label}, paired"
                differences.append(
                    number(experiment, f"difference.{series.key}.{trials}", (row, column), change, UNIT, **about)
                )  # fmt: skip
    return Shown((*numbers, *differences, *_reached(experiment, numbers)), draw_curves(experiment, numbers))


def _reached(experiment: Experiment, numbers: Sequence[Number]) -> list[Number]:
    """Return ``reached.<key>``: the fewest trials with which a series is as good as the first one with its most."""
    by_series = {
        series.key: {int(one.key.rpartition(".")[2]): one for one in numbers if one.key.startswith(f"{series.key}.")}
        for series in experiment.series
    }
    (_, first), *others = by_series.items()
    goal = first[max(first)]
    found: list[Number] = []
    for other, own in others:
        enough = [trials for trials, one in sorted(own.items()) if trials and one.value <= goal.value]
        if enough:
            label = next(series.label for series in experiment.series if series.key == other)
            row = f"trials with which {label} is as good as {experiment.series[0].label} with {max(first)}"
            reached = replace(goal, key=f"reached.{other}", row=row, column="trials", value=float(enough[0]))
            found.append(replace(reached, low=None, high=None, unit="", paper=None))
    return found
