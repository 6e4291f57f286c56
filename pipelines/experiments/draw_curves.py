"""Curves of the error over the number of trials."""

from collections.abc import Sequence

import numpy as np
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

from pipelines.experiments.experiment import Experiment
from pipelines.experiments.numbers import Number

STYLES = (
    ("#0072B2", "o", "-"),
    ("#D55E00", "s", "--"),
    ("#009E73", "^", ":"),
    ("#CC79A7", "D", "-."),
    ("#666666", "v", "--"),
)
"""(colour, marker, line) of each series."""


def draw_curves(experiment: Experiment, numbers: Sequence[Number]) -> Figure:
    """Draw a curve for each series, its 95% interval shaded; the axis of trials is logarithmic.

    What does not depend on trials is a line at its value, which the legend tells: the axis is that of the curves.
    """
    figure = Figure(figsize=(7.5, 4.8), layout="constrained")
    FigureCanvasAgg(figure)
    ax = figure.subplots()
    everywhere, lowest, highest = set[int](), np.inf, 0.0
    for series, (color, marker, line) in zip(experiment.series, STYLES * len(experiment.series), strict=False):
        own = [one for one in numbers if one.key.startswith(f"{series.key}.")]
        trials = [int(one.key.rpartition(".")[2]) for one in own]
        values = np.array([(one.value, one.low, one.high) for one in own], dtype=np.float64)
        if trials == [0]:
            ax.axhline(values[0, 0], color="#222222", linewidth=1, label=f"{series.label}: {values[0, 0]:.3g}")
            continue
        everywhere |= set(trials)
        lowest, highest = min(lowest, values.min()), max(highest, values.max())
        ax.plot(trials, values[:, 0], color=color, marker=marker, linestyle=line, label=series.label)
        ax.fill_between(trials, values[:, 1], values[:, 2], color=color, alpha=0.15, linewidth=0)
    ax.set_xscale("log")
    ax.set_xticks(sorted(everywhere), [str(count) for count in sorted(everywhere)])
    ax.set_xticks([], minor=True)
    ax.set(xlabel="trials trained with", ylabel="mean absolute error on the test trials, scaled")
    ax.set_ylim(0.95 * lowest, 1.02 * highest)
    ax.grid(alpha=0.25)
    ax.legend()
    ax.set_title(f"{experiment.title}:\n{len(numbers[0].seeds)} seeds, 95% intervals")
    return figure
