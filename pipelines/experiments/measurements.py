"""Kinds of measurements, and where their raw results are."""

from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

from common.domain.errors import RequestError
from pipelines.experiments.experiment import Experiment
from pipelines.experiments.measure_examples import measure_examples
from pipelines.experiments.measure_mdes import measure_mdes
from pipelines.experiments.measure_models import measure_models
from pipelines.experiments.measure_optimise import measure_optimisations
from pipelines.experiments.measure_trials import measure_active, measure_sample_size
from pipelines.experiments.parameters import Parameters
from pipelines.experiments.place import Place, Report
from pipelines.experiments.raw import FILE, Raw, read_raw

MEASUREMENTS: dict[str, Callable[[Any, Path, Place, Report], None]] = {
    "models": measure_models,
    "optimise": measure_optimisations,
    "examples": measure_examples,
    "mdes": measure_mdes,
    "sample_size": measure_sample_size,
    "active": measure_active,
}
"""Kind -> what makes the raw results: function of (parameters, folder, place, report)."""


def measure(parameters: Parameters, place: Place, report: Report) -> Path:
    """Make what is missing of a measurement's raw results, and return their folder."""
    folder = place.raw / parameters.folder
    MEASUREMENTS[parameters.kind](parameters, folder, place, report)
    return folder


def find_raw(experiment: Experiment, raw: Path) -> Mapping[str, Raw]:
    """Return the raw results of an experiment, by the name of the measurement.

    Raises:
        RequestError: There are none, or only a part of them.
    """
    found: dict[str, Raw] = {}
    for name, parameters in experiment.measurements.items():
        path = raw / parameters.folder / FILE
        if not path.is_file():
            raise RequestError(
                f"{experiment.name}: expected raw results in {path}, got none: run `frugal evaluate {experiment.name}`"
            )
        found[name] = read_raw(path)
        if not found[name].is_complete:
            raise RequestError(
                f"{experiment.name}: expected {found[name].header['rows']} rows in {path}, got "
                f"{len(found[name].rows)}: run `frugal evaluate {experiment.name}`, it goes on where it stopped"
            )
    return found
