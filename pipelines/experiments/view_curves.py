"""Errors of MDEs over the number of trials that they were trained with, and differences between two ways."""

from collections.abc import Mapping

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

    ``difference.<key>.<trials>`` is the first series minus that one, paired by seed and sample.

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
    return Shown((*numbers, *differences), draw_curves(experiment, numbers))
