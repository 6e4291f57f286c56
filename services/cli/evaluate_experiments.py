"""The paper's experiments: data sets that they need are made, then what is missing of their raw results."""

import time
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from services.cli.asking import say
from services.cli.assets import ensure
from services.cli.progress import bars

if TYPE_CHECKING:
    from pipelines.experiments.experiment import Experiment
    from pipelines.experiments.place import Place


def evaluate_experiments(experiments: "Sequence[Experiment]", place: "Place") -> None:
    """Measure experiments; one of equal measurements is made."""
    from pipelines.experiments.measurements import measure

    for name in sorted(frozenset[str]().union(*(one.needed for one in experiments))):
        ensure(name, place.data, workers=place.workers)
    done: set[Path] = set()
    with bars() as progress:
        for experiment in experiments:
            for name, parameters in experiment.measurements.items():
                folder, began = place.raw / parameters.folder, time.perf_counter()
                if folder in done:
                    continue
                done.add(folder)
                label = experiment.name if len(experiment.measurements) == 1 else f"{experiment.name}, {name}"
                row = progress.add_task(label, total=None)
                measure(
                    parameters,
                    place,
                    lambda done, total, row=row: progress.update(row, completed=done, total=total),
                )
                say(f"{label}: {folder}, {time.perf_counter() - began:.0f} s")
