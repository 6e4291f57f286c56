"""Bars of the paper's comparisons: error beside time, and which model predicted how many actions."""

from collections.abc import Sequence

import numpy as np
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

from pipelines.experiments.experiment import Experiment
from pipelines.experiments.numbers import Number
from pipelines.figures import MODEL_STYLES, OTHER_STYLES

ERROR, TIME = "#0072B2", "#E69F00"
LABEL = {"facecolor": "white", "edgecolor": "none", "pad": 1.5}


def draw_error_and_time(experiment: Experiment, numbers: Sequence[Number]) -> Figure:
    """Draw a pair of bars for each series: mean action error on the left axis, time on the right, logarithmic one."""
    by_key = {one.key: one for one in numbers}
    figure, places = _canvas(experiment), np.arange(len(experiment.series))
    left = figure.subplots()
    right = left.twinx()
    for ax, part, offset, color in ((left, "error", -0.2, ERROR), (right, "time", 0.2, TIME)):
        drawn = [by_key[f"{series.key}.{part}"] for series in experiment.series]
        hatch = "" if part == "error" else "//"
        values = np.array([one.value for one in drawn])
        ends = np.array([(one.value - (one.low or 0), (one.high or 0) - one.value) for one in drawn]).T
        ax.bar(places + offset, values, 0.38, color=color, hatch=hatch, edgecolor="white")
        ax.errorbar(places + offset, values, np.maximum(ends, 0), fmt="none", color="black", capsize=3, linewidth=1)
    right.set_yscale("log")
    left.set_ylabel("action error, mean [mm]", color=ERROR)
    right.set_ylabel("time of an optimisation [s], log scale", color="#A66F00")
    left.set_xticks(places, [series.label for series in experiment.series], rotation=15)
    left.grid(axis="y", alpha=0.25)
    left.set_title(f"{experiment.title}: {drawn[0].samples} targets, 95% intervals")
    return figure


def draw_usage(experiment: Experiment, numbers: Sequence[Number], family: Sequence[str]) -> Figure:
    """Draw a stacked bar for each series: evaluated actions by the model that predicted them."""
    by_key = {one.key: one for one in numbers}
    figure, places = _canvas(experiment), np.arange(len(experiment.series))
    ax, others = figure.subplots(), iter(OTHER_STYLES * 8)
    below = np.zeros(len(places))
    for model, hatch in zip(family, ("", "//", "..", "xx", "oo") * len(family), strict=False):
        values = np.array([by_key[f"{series.key}.{model}"].value for series in experiment.series])
        color, _ = MODEL_STYLES.get(model) or next(others)
        ax.bar(places, values, 0.6, bottom=below, color=color, hatch=hatch, edgecolor="white", label=model)
        for place, value, base in zip(places.tolist(), values, below, strict=True):
            if value >= 2:
                ax.text(place, base + value / 2, f"{value:.1f}", ha="center", va="center", fontsize=8, bbox=LABEL)
        below += values
    ax.set_ylim(top=1.06 * float(below.max()))
    ax.set_ylabel("evaluated actions of an optimisation, mean")
    ax.set_xticks(places, [series.label for series in experiment.series], rotation=15)
    ax.legend(loc="upper left", bbox_to_anchor=(1, 1))
    ax.set_title(f"{experiment.title}: {numbers[0].samples} targets")
    return figure


def _canvas(experiment: Experiment) -> Figure:
    figure = Figure(figsize=(3.5 + 1.2 * len(experiment.series), 4.8), layout="constrained")
    FigureCanvasAgg(figure)
    return figure
