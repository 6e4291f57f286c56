"""Figures drawn from raw results; nothing is computed here that a reader could not check in the trials."""

from collections.abc import Sequence
from pathlib import Path

import matplotlib as mpl
import numpy as np
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.image import AxesImage
from matplotlib.lines import Line2D

from common.domain.case import Case
from common.domain.grid import Floats, Grid
from common.domain.heightmap import shift
from common.domain.trial import Result, Trial
from common.storage.results import other_errors
from common.tasks.plating_turn import turned_heights

MODEL_STYLES: dict[str, tuple[str, str]] = {
    "heuristic": ("#E69F00", "^"),
    "learned": ("#009E73", "s"),
    "simulator": ("#0072B2", "o"),
}
"""Model -> (colour, marker): the Okabe-Ito palette, and a shape each so that colour is never the only cue."""

OTHER_STYLES: tuple[tuple[str, str], ...] = (("#CC79A7", "D"), ("#D55E00", "v"), ("#56B4E9", "P"), ("#F0E442", "X"))
CM = 100.0


def draw_placement(case: Case, result: Result) -> Figure:
    """Draw the paper's four panels: scene, target, evaluated actions, achieved scene.

    The achieved scene is the prediction of the model that evaluated the chosen action.
    """
    figure = Figure(figsize=(15, 4.6), layout="constrained")
    FigureCanvasAgg(figure)
    axes: Sequence[Axes] = figure.subplots(1, 4, sharex=True, sharey=True)
    image, handles = draw_panels(axes, case, result.trials, result.action, result.heights)
    figure.colorbar(image, ax=list(axes), label="height [mm]", shrink=0.8, pad=0.01)
    figure.legend(handles=handles, loc="outside lower center", ncols=len(handles), facecolor="#BBBBBB", framealpha=1)
    figure.suptitle(_headline(case, result))
    return figure


def draw_panels(
    axes: Sequence[Axes], case: Case, trials: Sequence[Trial], action: tuple[float, ...], achieved: Floats
) -> tuple[AxesImage, list[Line2D]]:
    """Draw scene, target, evaluated actions and achieved scene on four axes; return an image and the legend's lines.

    Args:
        axes: The four axes.
        case: Scene and target.
        trials: The evaluated actions.
        action: The best one.
        achieved: What it leads to ``(H, W)`` [m].
    """
    grid, scene = case.state.grid, case.state.scene.heights
    panels = (scene, case.target, scene, achieved)
    titles = ("Initial scene and item", "Target", f"{len(trials)} evaluated actions", "Achieved with the best action")
    limits = float(min(p.min() for p in panels)) * 1e3, float(max(p.max() for p in panels)) * 1e3
    images: list[AxesImage] = []
    for ax, heights, title in zip(axes, panels, titles, strict=True):
        images.append(draw_heights(ax, heights, grid, limits, faded=title.endswith("actions")))
        ax.set_title(title)
        ax.set_xlabel("x [cm]")
    axes[0].set_ylabel("y [cm]")

    draw_outline(axes[0], case.state.item.heights, grid, (0.0, 0.0))
    handles: list[Line2D] = [_outline_handle()]
    if case.true_action is not None:
        handles.append(
            _cross(axes[1], case.true_action, "white", "true action" if case.same_item else "target's action")
        )
        _cross(axes[3], case.true_action, "white", "", size=17)
    handles += _draw_trials(axes[2], trials)
    draw_outline(axes[3], case.state.item.heights, grid, action)
    handles.append(_cross(axes[3], action, "#D55E00", "best action"))
    _cross(axes[2], action, "#D55E00", "")
    return images[-1], handles


def save_figure(figure: Figure, path: Path) -> tuple[Path, Path]:
    """Write ``path`` as PNG and as SVG and return both paths."""
    png, svg = path.with_suffix(".png"), path.with_suffix(".svg")
    with mpl.rc_context({"svg.hashsalt": "frugal"}):
        figure.savefig(png, dpi=150)
        figure.savefig(svg, metadata={"Date": None})
    return png, svg


def draw_heights(
    ax: Axes,
    heights: Floats,
    grid: Grid,
    limits: tuple[float, float],
    *,
    faded: bool = False,
    colours: str = "cividis",
) -> AxesImage:
    """Draw heights ``(H, W)`` [m] from above; ``limits`` of the colours in millimetres."""
    half_x, half_y = (CM * half for half in grid.half_extent)
    ax.set_aspect("equal")
    ax.set_facecolor("white")
    return ax.imshow(
        heights * 1e3,
        origin="lower",
        extent=(-half_x, half_x, -half_y, half_y),
        cmap="gray" if faded else colours,
        vmin=limits[0],
        vmax=limits[1] * (1.6 if faded else 1.0),
        interpolation="nearest",
    )


def draw_outline(ax: Axes, item: Floats, grid: Grid, action: tuple[float, ...]) -> None:
    """Draw the outline of an item's thickness ``(H, W)`` [m] where an action puts it."""
    turned = turned_heights(item, grid, action[2]) if len(action) == 3 else item
    moved = shift(turned, action[0] / grid.cell, action[1] / grid.cell)
    ax.contour(
        grid.x * CM,
        grid.y * CM,
        moved,
        levels=[float(np.max(item)) * 0.4],
        colors="#D55E00",
        linestyles="--",
        linewidths=1.4,
    )


def _outline_handle() -> Line2D:
    return Line2D([], [], color="#D55E00", linestyle="--", label="item's outline")


def _cross(ax: Axes, action: tuple[float, ...], color: str, label: str, *, size: int = 11) -> Line2D:
    (line,) = ax.plot(
        action[0] * CM,
        action[1] * CM,
        "X",
        color=color,
        markeredgecolor="black",
        markersize=size,
        linestyle="none",
        label=label,
    )
    return line


def _draw_trials(ax: Axes, trials: Sequence[Trial]) -> list[Line2D]:
    handles: list[Line2D] = []
    others = iter(OTHER_STYLES * 8)
    for model in sorted({trial.model for trial in trials if trial.reward is not None}):
        color, marker = MODEL_STYLES.get(model) or next(others)
        actions = np.array([trial.action for trial in trials if trial.model == model and trial.reward is not None]) * CM
        (line,) = ax.plot(
            actions[:, 0], actions[:, 1], marker, color=color, markeredgecolor="white", markersize=7, linestyle="none",
            label=f"{model} ({len(actions)})",
        )  # fmt: skip
        handles.append(line)
    return handles


def _headline(case: Case, result: Result) -> str:
    text = f"{case.name}: best action ({result.action[0] * CM:+.2f}, {result.action[1] * CM:+.2f}) cm, "
    text += "".join(f"turned by {np.degrees(yaw):+.1f}°, " for yaw in result.action[2:])
    text += f"mean height error {-result.reward * 1e3:.2f} mm"
    if case.true_action is not None and case.same_item:
        error = float(np.hypot(*np.subtract(result.action[:2], case.true_action[:2])))
        turned = "".join(f" and {np.degrees(value):.1f}°" for value in other_errors(result, case).values())
        text += f", {error * 1e3:.2f} mm{turned} from the true action"
    return text
