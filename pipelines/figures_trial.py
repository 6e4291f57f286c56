"""The figure of one executed action: scene, item, outcome, and what the action changed."""

from collections.abc import Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

from common.domain.case import Case
from common.domain.errors import RequestError
from pipelines.figures import CM, draw_heights, draw_outline


def draw_trial(case: Case, *, title: str) -> Figure:
    """Draw four panels: scene with the item's outline at the action, item, outcome, outcome less scene.

    Raises:
        RequestError: Nobody knows the case's action.
    """
    action = case.reference_action
    if action is None:
        raise RequestError(f"{case.name}: expected a trial with its own item's action, got none")
    grid, scene, item = case.state.grid, case.state.scene.heights, case.state.item.heights
    change = case.target - scene
    figure = Figure(figsize=(15, 4.2), layout="constrained")
    FigureCanvasAgg(figure)
    axes: Sequence[Axes] = figure.subplots(1, 4, sharex=True, sharey=True)
    limits = float(min(scene.min(), case.target.min(), 0.0)) * 1e3, float(max(case.target.max(), item.max())) * 1e3
    image = None
    for ax, heights, name in zip(axes, (scene, item, case.target), ("Scene", "Item", "Outcome"), strict=False):
        image = draw_heights(ax, heights, grid, limits)
        ax.set_title(name)
    widest = max(float(np.abs(change).max()) * 1e3, 1.0)
    difference = draw_heights(axes[3], change, grid, (-widest, widest), colours="RdBu_r")
    axes[3].set_title("Outcome - scene")
    for ax in (axes[0], axes[3]):
        draw_outline(ax, item, grid, action)
    for ax in axes:
        ax.set_xlabel("x [cm]")
    axes[0].set_ylabel("y [cm]")
    assert image is not None
    figure.colorbar(image, ax=list(axes[:3]), label="height [mm]", shrink=0.8, pad=0.01)
    figure.colorbar(difference, ax=axes[3], label="difference [mm]", shrink=0.8, pad=0.01)
    x, y, *turn = action
    turned = "".join(f" turned by {np.degrees(yaw):+.1f}°" for yaw in turn)
    figure.suptitle(f"{title}: item at ({x * CM:+.2f}, {y * CM:+.2f}) cm{turned}")
    return figure
