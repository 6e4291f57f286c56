"""Example results: scene, target, evaluated actions, achieved scene, one line a target."""

from collections.abc import Mapping

import numpy as np
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from common.domain.case import Case
from common.domain.grid import Grid
from common.domain.scene import Item, Scene, State
from common.domain.trial import Trial
from pipelines.experiments.arrays import unpack
from pipelines.experiments.experiment import Experiment
from pipelines.experiments.numbers import Number, number
from pipelines.experiments.raw import Raw, Row
from pipelines.experiments.shown import Shown
from pipelines.experiments.statistics import Estimate
from pipelines.figures import draw_panels

MM = 1000.0
DRAWN_MATERIAL = np.array([1000.0, 1e5, 0.4])
"""Density, Young's modulus and Poisson's ratio of an item that is only drawn."""


def examples(experiment: Experiment, results: Mapping[str, Raw]) -> Shown:
    """Return ``<region>.error`` of each example, the distance of its answer from the true action, and draw them all."""
    (raw,) = results.values()
    numbers: list[Number] = []
    for row in raw.rows:
        error = MM * row["action_error_m"]
        numbers.append(
            number(
                experiment,
                f"{row['region']}.error",
                (f"item over {row['region'].replace('_', ' ')}", "action error"),
                Estimate(error, error, error),
                "mm",
                seeds=[row["seed"]],
                samples=1,
            )
        )
    return Shown(tuple(numbers), _draw(experiment, raw))


def _draw(experiment: Experiment, raw: Raw) -> Figure:
    figure = Figure(figsize=(15, 4.3 * len(raw.rows)), layout="constrained")
    FigureCanvasAgg(figure)
    axes = figure.subplots(len(raw.rows), 4, squeeze=False)
    labels: dict[str, Line2D] = {}
    for line, row in zip(axes, raw.rows, strict=True):
        case, trials = _case(row), [_trial(trial) for trial in row["trials"]]
        image, handles = draw_panels(line, case, trials, tuple(row["action"]), unpack(row["achieved"]))
        figure.colorbar(image, ax=list(line), label="height [mm]", shrink=0.8, pad=0.01)
        line[3].set_title(f"Achieved, {MM * row['action_error_m']:.1f} mm from the true action")
        counts = {model: sum(trial.model == model for trial in trials) for model in raw.header["parameters"]["family"]}
        line[2].set_title(", ".join(f"{model} {count}" for model, count in counts.items() if count))
        labels |= {str(handle.get_label()).partition(" (")[0]: handle for handle in handles}
    figure.legend(
        list(labels.values()), list(labels), loc="outside lower center", ncols=len(labels), facecolor="#BBBBBB",
        framealpha=1,
    )  # fmt: skip
    figure.suptitle(f"{experiment.title}: {raw.rows[0]['method']}")
    return figure


def _case(row: Row) -> Case:
    scene, item, target = (unpack(row[name]) for name in ("scene", "item", "target"))
    grid = Grid(*scene.shape, cell=row["cell"])
    none = np.zeros((3, *grid.shape), dtype=np.float32)
    materials = np.where(item > 0, DRAWN_MATERIAL[:, None, None], none).astype(np.float32)
    state = State(Scene(grid, scene, none), Item(item, materials))
    return Case(row["case"], row["seed"], state, target, tuple(row["true_action"]), row["same_item"])


def _trial(trial: Row) -> Trial:
    fields = ("index", "model", "instance", "version", "reward")
    return Trial(action=tuple(trial["action"]), **{name: trial[name] for name in fields})
