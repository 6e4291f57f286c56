"""Draw a data set: a contact sheet of its samples, and what it covers."""

from collections.abc import Sequence
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure, SubFigure
from numpy.typing import NDArray

from common.domain.deviation import deviation
from common.domain.grid import Floats, Grid
from common.domain.heightmap import shift
from common.domain.scene import RIGID_MODULUS
from common.storage.dataset import Dataset, Samples
from common.storage.dataset_card import Split

MM, CM = 1e3, 100.0
SOFT, RIGID = "#0072B2", "#D55E00"
PANELS = ("scene", "item at the action", "outcome", "outcome - heuristic")
SHEET_COLUMNS = 2


def heuristic_outcomes(samples: Samples, grid: Grid) -> NDArray[np.float32]:
    """Return what the heuristic predicts: scene plus shifted item ``(N, H, W)`` [m]."""
    moved = [
        shift(item, *(action / grid.cell)) for item, action in zip(samples.item_heights, samples.actions, strict=True)
    ]
    return samples.scene_heights + np.stack(moved)


def choose_samples(samples: Samples, deviations: Floats, count: int) -> list[int]:
    """Return samples that show the whole range: at even steps of the heuristic's deviation ``(N,)``."""
    order = np.argsort(deviations, kind="stable")
    return [int(order[place]) for place in np.linspace(0, len(order) - 1, min(count, len(order))).round().astype(int)]


def draw_dataset(dataset: Dataset, split: Split = "train", *, count: int = 12) -> Figure:
    """Draw a contact sheet of ``count`` samples and the distributions of one split.

    Each row has the scene, the item where the action puts it, the outcome, and its difference to the heuristic.
    """
    grid = dataset.card.grid.grid()
    samples = dataset.samples(split)
    heuristic = heuristic_outcomes(samples, grid)
    deviations = deviation(samples.outcomes, heuristic)
    chosen = choose_samples(samples, deviations, count)
    rows = -(-len(chosen) // SHEET_COLUMNS)
    figure = Figure(figsize=(17, 1.9 * rows + 8.5), layout="constrained")
    FigureCanvasAgg(figure)
    card = dataset.card
    failed = sum(card.failed[split].values())
    figure.suptitle(
        f"{card.name}, {split}: {len(samples)} samples in {card.states[split]} states, {failed} more failed; "
        f"preset {card.preset}, seed {card.seed}, {card.model} {card.version} ({card.level})"
    )
    parts = figure.subfigures(2, 1, squeeze=False, height_ratios=[1.9 * rows, 8.0])[:, 0]
    _draw_sheet(parts[0], samples, heuristic, deviations, chosen, grid)
    _draw_distributions(parts[1], samples, deviations)
    return figure


def _draw_sheet(
    figure: SubFigure, samples: Samples, heuristic: Floats, deviations: Floats, chosen: Sequence[int], grid: Grid
) -> None:
    rows = -(-len(chosen) // SHEET_COLUMNS)
    axes: NDArray[Any] = figure.subplots(rows, SHEET_COLUMNS * len(PANELS), squeeze=False)
    top = float(samples.outcomes[list(chosen)].max()) * MM
    half_x, half_y = (CM * half for half in grid.half_extent)
    image = difference = None
    for ax in axes.flat:
        ax.set_axis_off()
    for place, index in enumerate(chosen):
        row, column = divmod(place, SHEET_COLUMNS)
        item = shift(samples.item_heights[index], *(samples.actions[index] / grid.cell))
        panels = (samples.scene_heights, item[None], samples.outcomes, samples.outcomes - heuristic)
        for number, (heights, title) in enumerate(zip(panels, PANELS, strict=True)):
            ax = axes[row, column * len(PANELS) + number]
            is_difference = number == len(PANELS) - 1
            shown = ax.imshow(
                heights[0 if len(heights) == 1 else index] * MM,
                origin="lower",
                extent=(-half_x, half_x, -half_y, half_y),
                cmap="RdBu_r" if is_difference else "cividis",
                vmin=-15 if is_difference else -5,
                vmax=15 if is_difference else top,
                interpolation="nearest",
            )
            image, difference = (image, shown) if is_difference else (shown, difference)
            if row == 0:
                ax.set_title(title, fontsize=9)
        stiffness = "rigid" if samples.rigid[index] else f"{_item_property(samples, 1)[index] / 1e3:.0f} kPa"
        notes = {
            0: f"{samples.layouts[index]}, {samples.places[index]}",
            1: f"{samples.kinds[index]}, {stiffness}",
            3: f"d = {deviations[index] * MM:.2f} mm",
        }
        for number, note in notes.items():
            ax, color = axes[row, column * len(PANELS) + number], "black" if number == 3 else "white"
            ax.text(0.03, 0.97, note, transform=ax.transAxes, fontsize=7, va="top", color=color)
    if image is not None and difference is not None:
        figure.colorbar(image, ax=axes, label="height [mm]", shrink=0.6, pad=0.01)
        figure.colorbar(difference, ax=axes, label="difference [mm]", shrink=0.6, pad=0.01)


def _draw_distributions(figure: SubFigure, samples: Samples, deviations: Floats) -> None:
    axes: NDArray[Any] = figure.subplots(2, 4)
    soft, rigid = ~samples.rigid, samples.rigid
    modulus = np.log10(_item_property(samples, 1))
    _histograms(axes[0, 0], modulus, soft, rigid, "item's Young's modulus, log10 of Pa")
    axes[0, 0].axvline(np.log10(RIGID_MODULUS), color="black", linewidth=0.8, linestyle=":")
    _histograms(axes[0, 1], _item_property(samples, 2), soft, rigid, "item's Poisson's ratio")
    thickness = samples.item_heights.max(axis=(1, 2)) * MM
    _histograms(axes[0, 2], thickness, soft, rigid, "item's largest thickness [mm]")
    _histograms(axes[0, 3], deviations * MM, soft, rigid, "heuristic's deviation d [mm]")
    for ax, names, label in (
        (axes[1, 0], samples.kinds, "item"),
        (axes[1, 1], samples.places, "what the action aims at"),
        (axes[1, 2], samples.layouts, "fries"),
    ):
        _bars(ax, names, deviations, label)
    for mask, color, label in ((soft, SOFT, "soft"), (rigid, RIGID, "rigid")):
        axes[1, 3].plot(*(samples.actions[mask] * CM).T, ".", color=color, markersize=3, label=label)
    axes[1, 3].set_aspect("equal")
    axes[1, 3].set_xlabel("action x [cm]")
    axes[1, 3].set_ylabel("action y [cm]")
    axes[0, 0].legend()


def _histograms(ax: Axes, values: Floats, soft: NDArray[np.bool_], rigid: NDArray[np.bool_], label: str) -> None:
    ax.hist([values[soft], values[rigid]], bins=30, stacked=True, color=[SOFT, RIGID], label=["soft", "rigid"])
    ax.set_xlabel(label)
    ax.set_ylabel("samples")


def _bars(ax: Axes, names: Sequence[str], deviations: Floats, label: str) -> None:
    """Draw the deviations of each group as a box plot, with the number of samples below its name."""
    groups = sorted(set(names))
    members = [deviations[np.array(names) == group] * MM for group in groups]
    ax.boxplot(members, showfliers=False, medianprops={"color": RIGID})
    ax.set_xticks(
        range(1, len(groups) + 1), [f"{group}\n{len(found)}" for group, found in zip(groups, members, strict=True)]
    )
    ax.tick_params(axis="x", labelsize=8)
    ax.set_xlabel(label)
    ax.set_ylabel("heuristic's deviation d [mm]")


def _item_property(samples: Samples, channel: int) -> NDArray[np.float32]:
    """Return the largest value of a material property of each item ``(N,)``."""
    return samples.item_materials[:, channel].max(axis=(1, 2))
