"""Figures of simulated placements: a strip of frames, and cross-sections side by side."""

from collections.abc import Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

from common.domain.grid import Grid
from pipelines.frames import Frame
from pipelines.sections import Section

CM = 100.0
ITEM, BOX, GROUND = "#D55E00", "#E69F00", "#BBBBBB"


def draw_frames(frames: Sequence[Frame], grid: Grid, *, title: str) -> Figure:
    """Draw cross-sections above top views, one column a frame."""
    figure = Figure(figsize=(2.3 * len(frames) + 0.8, 4.4), layout="constrained")
    FigureCanvasAgg(figure)
    axes = figure.subplots(2, len(frames), squeeze=False, height_ratios=(1, 2.2), sharex="row", sharey="row")
    lowest, highest = (float(pick([pick(frame.heights) for frame in frames])) * 1e3 for pick in (np.min, np.max))
    half_x, half_y = (CM * half for half in grid.half_extent)
    image = None
    for (section_axes, top_axes), frame in zip(axes.T, frames, strict=True):
        draw_section(section_axes, frame.section)
        section_axes.set_title(f"{frame.time:.2f} s")
        section_axes.set_xlabel("along the item [cm]")
        image = top_axes.imshow(
            frame.heights * 1e3,
            origin="lower",
            extent=(-half_x, half_x, -half_y, half_y),
            cmap="cividis",
            vmin=lowest,
            vmax=highest,
            interpolation="nearest",
        )
        top_axes.set_xlabel("x [cm]")
    axes[0, 0].set_ylabel("z [cm]")
    axes[1, 0].set_ylabel("y [cm]")
    assert image is not None
    figure.colorbar(image, ax=list(axes[1]), label="height [mm]", shrink=0.9, pad=0.01)
    figure.suptitle(title)
    return figure


def draw_sections(sections: Sequence[tuple[str, Section]], *, title: str) -> Figure:
    """Draw named cross-sections one below the other, on common axes."""
    rows = -(-len(sections) // 2)
    figure = Figure(figsize=(10, 1.75 * rows + 0.6), layout="constrained")
    FigureCanvasAgg(figure)
    axes = figure.subplots(rows, 2, squeeze=False, sharex=True, sharey=True)
    for ax, (name, section) in zip(axes.ravel(), sections, strict=False):
        draw_section(ax, section)
        ax.set_title(name, fontsize=10)
    for ax in axes.ravel()[len(sections) :]:
        ax.set_visible(False)
    for ax in axes[-1]:
        ax.set_xlabel("along the item [cm]")
    for ax in axes[:, 0]:
        ax.set_ylabel("z [cm]")
    figure.suptitle(title)
    return figure


def draw_section(ax: Axes, section: Section) -> None:
    """Draw plate, boxes and item with its material lines, equal scales on both axes."""
    along = section.along * CM
    ax.fill_between(along, section.height[0] * CM, section.ground * CM, color=GROUND, linewidth=0)
    if section.boxes.min() < 0:
        inside = (float(section.boxes.min()) - 1.0, 0.0)
        ax.contourf(along, section.height * CM, section.boxes, levels=inside, colors=[BOX])
        ax.contour(along, section.height * CM, section.boxes, levels=[0.0], colors="black", linewidths=0.5)
    lines = section.item * CM
    ring = np.concatenate([lines[0], lines[-1][::-1]])
    ax.fill(*ring.T, color=ITEM, alpha=0.75, linewidth=0)
    for line in lines:
        ax.plot(*line.T, color="black", linewidth=0.6)
    ax.set_aspect("equal")
    ax.set_ylim(section.height[0] * CM, section.height[-1] * CM)
