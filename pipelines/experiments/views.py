"""Views: what makes numbers and a figure of the raw results of an experiment."""

from collections.abc import Callable, Mapping

from pipelines.experiments.experiment import Experiment
from pipelines.experiments.raw import Raw
from pipelines.experiments.shown import Shown
from pipelines.experiments.view_curves import learning_curves
from pipelines.experiments.view_examples import examples
from pipelines.experiments.view_mdes import mde_errors
from pipelines.experiments.view_models import model_errors
from pipelines.experiments.view_optimisations import error_and_time, usage

View = Callable[[Experiment, Mapping[str, Raw]], Shown]

VIEWS: dict[str, View] = {
    "model_errors": model_errors,
    "mde_errors": mde_errors,
    "examples": examples,
    "error_and_time": error_and_time,
    "usage": usage,
    "learning_curves": learning_curves,
}
"""Name -> function of (experiment, raw results by the name of the measurement)."""
