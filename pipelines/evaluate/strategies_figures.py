"""Figures of the comparison of strategies, drawn from the table: Pareto plots and sweeps."""

from collections import defaultdict
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

Row = Mapping[str, Any]

STYLES: dict[str, tuple[str, str]] = {
    "transport": ("#D55E00", "o"),
    "residual": ("#009E73", "s"),
    "threshold": ("#0072B2", "D"),
    "reference": ("black", "^"),
    "polish": ("#CC79A7", "v"),
    "botorch:logei": ("#E69F00", "P"),
    "botorch:ucb": ("#56B4E9", "X"),
    "botorch:mfkg": ("#999999", "*"),
}
"""Family -> (colour, marker)."""
OTHER = ("#666666", "h")
NO_CALLS = 0.5
"""Where methods without any call of the trusted model stand on a logarithmic axis."""
MEASURES = (("error_mean_m", 1e3, "action error, mean [mm]"), ("reward_regret_m", 1e6, "regret of true reward [um]"))
COSTS = (("wall_s", "wall time of one optimisation [s]"), ("simulator_calls", "calls of the trusted model"))


def draw_pareto(rows: Sequence[Row]) -> Figure:
    """Draw action error and regret over time and over calls, with 95% intervals and the best for its cost.

    Methods with swapped MDEs, or more than one evaluation in flight, are left out.
    """
    shown = [row for row in rows if not row["options"] or row["family"] == "threshold"]
    shown = [row for row in shown if "mde" not in row["options"]]
    figure = Figure(figsize=(14, 10), layout="constrained")
    FigureCanvasAgg(figure)
    axes = figure.subplots(2, 2, sharey="row", sharex="col")
    for line, (measure, scale, label) in zip(axes, MEASURES, strict=True):
        for ax, (cost, axis) in zip(line, COSTS, strict=True):
            _draw_families(ax, shown, cost, measure, scale)
            _draw_front(ax, shown, cost, measure, scale)
            ax.set(xscale="log", yscale="log")
            ax.grid(alpha=0.25, which="both")
            ax.set_xlabel(axis)
            if cost == "simulator_calls":
                _count(ax)
        line[0].set_ylabel(label)
    handles, labels = axes[0, 1].get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside lower center", ncols=min(len(labels), 6))
    figure.suptitle(f"{rows[0]['targets']} targets, 95% intervals; lines join one method at growing budgets")
    return figure


def draw_sweeps(rows: Sequence[Row]) -> Figure:
    """Draw action error, calls and time over d_max, and action error over the budget of each family."""
    figure = Figure(figsize=(14, 5), layout="constrained")
    FigureCanvasAgg(figure)
    left, right = figure.subplots(1, 2)
    thresholds = sorted(
        (row for row in rows if row["strategy"].partition("+")[0] == "threshold" and "mde" not in row["options"]),
        key=lambda row: row["d_max"],
    )
    calls = left.twinx()
    if thresholds:
        at = [row["d_max"] for row in thresholds]
        color, marker = STYLES["threshold"]
        _bars(left, at, thresholds, "error_mean_m", 1e3, color=color, marker=marker, label="action error")
        _bars(calls, at, thresholds, "simulator_calls", 1.0, color="#999999", marker=".", label="calls")
    else:
        left.text(0.5, 0.5, "threshold was not compared", ha="center")
    left.set(xlabel="d_max of threshold", ylabel="action error, mean [mm]")
    calls.set_ylabel("calls of the trusted model (grey)")
    budgeted = [row for row in rows if not row["options"] and row["family"] != "threshold"]
    budgeted = [row for row in budgeted if row["simulator_calls"]["value"]]
    for family, members in _families(budgeted).items():
        members = sorted(members, key=lambda row: row["budget"])
        color, marker = STYLES.get(family, OTHER)
        at = [row["budget"] for row in members]
        _bars(right, at, members, "error_mean_m", 1e3, color=color, marker=marker, label=family)
    right.set(xscale="log", yscale="log", xlabel="budget: most calls of the trusted model")
    right.set_ylabel("action error, mean [mm]")
    _count(right)
    right.grid(alpha=0.25, which="both")
    right.legend()
    return figure


def _count(ax: Axes) -> None:
    """Mark numbers of calls on a logarithmic axis."""
    limits = ax.get_xlim()
    ticks = [at for at in (NO_CALLS, 1, 2, 3, 6, 12, 25, 50, 100) if limits[0] <= at <= limits[1]]
    ax.set_xticks(ticks, ["none" if at == NO_CALLS else str(at) for at in ticks])
    ax.set_xticks([], minor=True)


def _families(rows: Sequence[Row]) -> dict[str, list[Row]]:
    found: defaultdict[str, list[Row]] = defaultdict(list)
    for row in rows:
        found[row["family"]].append(row)
    return dict(found)


def _draw_families(ax: Axes, rows: Sequence[Row], cost: str, measure: str, scale: float) -> None:
    for family, members in _families(rows).items():
        members = sorted(members, key=lambda row: row[cost]["value"])
        color, marker = STYLES.get(family, OTHER)
        at = [max(row[cost]["value"], NO_CALLS) if cost == "simulator_calls" else row[cost]["value"] for row in members]
        _bars(ax, at, members, measure, scale, color=color, marker=marker, label=family)
        for x, row in zip(at, members, strict=True):
            text = row["strategy"] if row["strategy"] in ("fast", "balanced", "quality") else ""
            text = f"{row['d_max']:g}" if family == "threshold" else text
            ax.annotate(text, (x, scale * row[measure]["value"]), (5, 5), textcoords="offset points", fontsize=8)


def _draw_front(ax: Axes, rows: Sequence[Row], cost: str, measure: str, scale: float) -> None:
    """Draw where no other method is both cheaper and better."""
    points = sorted(
        (max(row[cost]["value"], NO_CALLS if cost == "simulator_calls" else 0.0), scale * row[measure]["value"])
        for row in rows
        if row[measure]["value"] is not None
    )
    front: list[tuple[float, float]] = []
    for x, y in points:
        if not front or y < front[-1][1]:
            front.append((x, y))
    if front:
        ax.step(*np.array(front).T, where="post", color="black", linestyle=":", linewidth=1, label="best for its cost")


def _bars(
    ax: Axes,
    at: Sequence[float],
    rows: Sequence[Row],
    measure: str,
    scale: float,
    *,
    color: str,
    marker: str,
    label: str,
) -> None:
    kept = [(x, row[measure]) for x, row in zip(at, rows, strict=True) if row[measure]["value"] is not None]
    if not kept:
        return
    x, figures = zip(*kept, strict=True)
    values, lows, highs = (scale * np.array([figure[name] for figure in figures]) for name in ("value", "low", "high"))
    ax.errorbar(
        x, values, (np.maximum(values - lows, 0), np.maximum(highs - values, 0)),
        color=color, marker=marker, label=label, linewidth=1, capsize=2, elinewidth=0.8,
    )  # fmt: skip
