"""What a data set is drawn from: presets of states and actions."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from common.domain.bodies import Material
from common.domain.errors import RequestError
from common.domain.grid import Grid
from common.domain.scene import Item, State
from common.tasks.plating import FLAT_RADIUS, Plating
from common.tasks.plating_items import RoundedRectangle, draw_item
from common.tasks.plating_sampler import (
    ITEM_KINDS,
    LAYOUTS,
    RIGID_SHARE,
    Settler,
    find_action,
    sample_action,
    sample_item,
    sample_scene,
)

WIDE_KINDS = dict.fromkeys(ITEM_KINDS, 0.12) | {"medallion": 0.22, "slice": 0.30}
"""The item's outline -> its share; the small ones leave room for bare plate beside the fries."""

LAYOUT_SHARES = dict.fromkeys(LAYOUTS, 0.18) | {"lone_heap": 0.28}
"""How the fries lie -> its share."""

PLACE_SHARES = {"anywhere": 0.22, "heap_edge": 0.32, "rim": 0.18, "bare": 0.28}
"""What an action aims at -> its share."""

NARROW_OUTLINE = RoundedRectangle(0.12, 0.08, 0.025)
NARROW_THICKNESS = 0.018
NARROW_MATERIAL = Material(1050.0, 3e4, 0.4)


@dataclass(frozen=True)
class DrawnItem:
    """An item and the name of its outline."""

    kind: str
    item: Item


def draw_wide(rng: np.random.Generator, grid: Grid) -> DrawnItem:
    """Draw an item of any outline, thickness and material."""
    kind = _draw(rng, WIDE_KINDS)
    return DrawnItem(kind, sample_item(rng, grid, kind=kind, rigid=bool(rng.random() < RIGID_SHARE)))


def draw_narrow(rng: np.random.Generator, grid: Grid) -> DrawnItem:
    """Return the one soft steak of the paper's setting: its outline, thickness, material and orientation are fixed."""
    del rng
    return DrawnItem("steak", draw_item(grid, NARROW_OUTLINE, thickness=NARROW_THICKNESS, material=NARROW_MATERIAL))


PRESETS: dict[str, Callable[[np.random.Generator, Grid], DrawnItem]] = {"wide": draw_wide, "narrow": draw_narrow}
"""Name -> how the item is drawn; scenes and actions are drawn alike in all."""


@dataclass(frozen=True)
class DrawnState:
    """A state and how it was drawn."""

    layout: str
    kind: str
    state: State


def draw_layout(rng: np.random.Generator) -> str:
    """Draw how the fries lie."""
    return _draw(rng, LAYOUT_SHARES)


def draw_state(rng: np.random.Generator, grid: Grid, *, preset: str, layout: str, settle: Settler) -> DrawnState:
    """Draw a settled scene and an item.

    Raises:
        RequestError: There is no such preset.
        ModelError: No scene came to rest.
    """
    if preset not in PRESETS:
        raise RequestError(f"expected a preset of {', '.join(PRESETS)}, got {preset!r}")
    drawn = PRESETS[preset](rng, grid)
    scene = sample_scene(rng, grid, settle=settle, layout=layout)
    return DrawnState(layout, drawn.kind, State(scene, drawn.item))


def draw_action(rng: np.random.Generator, state: State) -> tuple[str, NDArray[np.float64]]:
    """Draw what an action aims at, and the action ``(2,)`` [m].

    Where the state leaves no action at the place that was drawn, it is ``anywhere``. At a heap's edge the sampler puts
    cells over cells; half a cell of noise makes every fraction of a cell as likely.
    """
    place = _draw(rng, PLACE_SHARES)
    action = find_action(rng, state, place=place)
    if action is None:
        place, action = "anywhere", sample_action(rng, state, place="anywhere")
    moved = action + rng.uniform(-0.5, 0.5, 2) * state.grid.cell
    low, high = Plating().bounds(state).T
    inside = (moved >= low).all() and (moved <= high).all() and np.hypot(*moved) <= FLAT_RADIUS
    return place, moved if inside else action


def _draw(rng: np.random.Generator, shares: Mapping[str, float]) -> str:
    return str(rng.choice(list(shares), p=list(shares.values())))
