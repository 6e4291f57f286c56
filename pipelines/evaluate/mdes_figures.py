"""Figures of the MDEs, drawn from raw results: reliability, and accept maps."""

from collections.abc import Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from numpy.typing import NDArray

from common.domain.heightmap import shift
from pipelines.evaluate.accept_maps import AcceptMap
from pipelines.evaluate.mdes import column
from pipelines.evaluate.mdes_runs import Run
from pipelines.figures import CM, MODEL_STYLES, OTHER_STYLES

BINS = 8


def draw_reliability(runs: Sequence[Run]) -> Figure:
    """Draw true against estimated deviations by bins of equal counts, for each model, and how often bounds hold.

    Left of each pair: mean and quartiles of the true deviations against the mean estimate. Right: share of the true
    deviations below the upper bound in bins of the estimate, beside the nominal share.
    """
    names = sorted({(run.judgements[0].model, run.judgements[0].variant) for run in runs})
    figure = Figure(figsize=(8, 3.6 * len(names)), layout="constrained")
    FigureCanvasAgg(figure)
    axes = figure.subplots(len(names), 2, squeeze=False)
    for row, (model, variant) in zip(axes, names, strict=True):
        same = [run for run in runs if (run.judgements[0].model, run.judgements[0].variant) == (model, variant)]
        truth, mean, upper = (
            np.concatenate([column(run, name) for run in same]) for name in ("truth", "mean", "upper")
        )
        color, marker = MODEL_STYLES.get(model) or OTHER_STYLES[0]
        _draw_bins(row[0], truth, mean, color, marker)
        row[0].set_title(f"{model}, {variant}: {len(same)} seeds")
        _draw_coverage(row[1], truth, mean, upper, same[0].nominal_coverage, color, marker)
    return figure


def draw_accept_maps(maps: Sequence[AcceptMap]) -> Figure:
    """Draw for each map the scene, the true and the estimated deviation, and where the model is accepted."""
    figure = Figure(figsize=(13, 3.4 * len(maps)), layout="constrained")
    FigureCanvasAgg(figure)
    axes = figure.subplots(len(maps), 4, squeeze=False)
    for row, drawn in zip(axes, maps, strict=True):
        _draw_scene(row[0], drawn)
        for ax, values, title in ((row[1], drawn.truth, "true"), (row[2], drawn.mean, "estimated")):
            image = ax.pcolormesh(drawn.x * CM, drawn.y * CM, values, cmap="cividis", vmin=0, vmax=1, shading="nearest")
            ax.contour(drawn.x * CM, drawn.y * CM, values, levels=[drawn.d_max], colors="white", linewidths=1.2)
            ax.set_title(f"{drawn.model}: {title} deviation")
        figure.colorbar(image, ax=row[2], label="deviation, scaled")
        _draw_decisions(row[3], drawn)
        for ax in row:
            ax.set_aspect("equal")
            ax.set_xlabel("x [cm]")
        row[0].set_ylabel("y [cm]")
    return figure


def _draw_bins(ax: Axes, truth: NDArray[np.float64], mean: NDArray[np.float64], color: str, marker: str) -> None:
    rows = [(m.mean(), t.mean(), *np.percentile(t, [25, 75])) for t, m in _binned(truth, mean)]
    at, centre, low, high = np.array(rows).T
    ax.plot([0, 1], [0, 1], color="#888888", linestyle=":")
    ax.vlines(at, low, high, color=color)
    ax.plot(at, centre, marker, color=color)
    ax.set(xlabel="estimated deviation", ylabel="true deviation: mean, quartiles", xlim=(0, 1), ylim=(0, 1))


def _draw_coverage(
    ax: Axes,
    truth: NDArray[np.float64],
    mean: NDArray[np.float64],
    upper: NDArray[np.float64],
    nominal: float,
    color: str,
    marker: str,
) -> None:
    rows = [(m.mean(), held.mean()) for held, m in _binned((truth <= upper).astype(np.float64), mean)]
    at, held = np.array(rows).T
    ax.axhline(nominal, color="#888888", linestyle=":")
    ax.plot(at, held, marker, color=color, linestyle="-")
    ax.set(xlabel="estimated deviation", ylabel="share below the upper bound", xlim=(0, 1), ylim=(0, 1.02))
    ax.set_title(f"{(truth <= upper).mean():.3f} in all, nominal {nominal:g}")


def _binned(
    values: NDArray[np.float64], by: NDArray[np.float64]
) -> list[tuple[NDArray[np.float64], NDArray[np.float64]]]:
    order = np.argsort(by, kind="stable")
    return [(values[part], by[part]) for part in np.array_split(order, min(BINS, len(order)))]


def _draw_scene(ax: Axes, drawn: AcceptMap) -> None:
    half_y, half_x = (CM * drawn.cell * length / 2 for length in drawn.scene.shape)
    ax.imshow(drawn.scene * 1e3, origin="lower", extent=(-half_x, half_x, -half_y, half_y), cmap="gray")
    for x, y in ((drawn.x[0], drawn.y[0]), (0.0, 0.0), (drawn.x[-1], drawn.y[-1])):
        moved = shift(drawn.item, x / drawn.cell, y / drawn.cell)
        rows, columns = drawn.scene.shape
        at_x = (np.arange(columns) - (columns - 1) / 2) * drawn.cell * CM
        at_y = (np.arange(rows) - (rows - 1) / 2) * drawn.cell * CM
        if (moved > 0).any():
            ax.contour(at_x, at_y, moved, levels=[float(drawn.item.max()) * 0.4], colors="#D55E00", linewidths=1.0)
    ax.set_title("scene, item at corners and centre")


def _draw_decisions(ax: Axes, drawn: AcceptMap) -> None:
    """Colour each action by what the mean's decision is worth; hatch what the upper bound accepts."""
    good, accepted = drawn.truth < drawn.d_max, drawn.mean < drawn.d_max
    kinds = np.where(good & accepted, 0, np.where(good, 1, np.where(accepted, 2, 3)))
    colors = ("#009E73", "#56B4E9", "#D55E00", "#DDDDDD")
    names = ("accepted, good", "refused, good", "accepted, bad", "refused, bad")
    for kind, (color, name) in enumerate(zip(colors, names, strict=True)):
        rows, columns = np.nonzero(kinds == kind)
        ax.scatter(drawn.x[columns] * CM, drawn.y[rows] * CM, c=color, marker="s", s=26, label=f"{name} ({len(rows)})")
    rows, columns = np.nonzero(drawn.upper < drawn.d_max)
    ax.scatter(
        drawn.x[columns] * CM, drawn.y[rows] * CM, c="black", marker=".", s=6, label=f"bound < d_max ({len(rows)})"
    )
    ax.set_title(f"d_max {drawn.d_max:g}")
    ax.legend(fontsize=6, loc="upper right", framealpha=0.9)
