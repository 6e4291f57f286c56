"""Random states and actions of the plating task, drawn from a generator that the caller seeds."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from common.domain.bodies import Bodies, Box, Material, Plate
from common.domain.errors import ModelError, RequestError
from common.domain.grid import Grid
from common.domain.scene import Item, Scene, State
from common.tasks.plating import FLAT_RADIUS, RIM_RADIUS, Plating, dinner_plate, render_scene
from common.tasks.plating_items import Outline, RoundedRectangle, TwoLobes, Wavy, draw_item

Settler = Callable[[Plate, Sequence[Box]], tuple[Box, ...]]
"""Lets boxes fall on a plate and returns them at rest; raises `ModelError` where they do not come to rest."""

ITEM_KINDS = ("steak", "ellipse", "irregular", "t_bone", "medallion")
MORE_KINDS = ("slice",)
"""Outlines that are drawn only where they are asked for: a piece of half the size."""

LAYOUTS = ("heap", "side_heap", "small_heaps", "scattered")
MORE_LAYOUTS = ("lone_heap",)
"""Layouts that are drawn only where they are asked for: 2 to 4 fries at the flat's edge, the plate bare beside them."""

PLACES = {"anywhere": 0.25, "heap_edge": 0.40, "rim": 0.25, "bare": 0.10}
"""Where actions are drawn -> share of the actions."""

RIGID_SHARE = 1 / 3
ATTEMPTS = 20


@dataclass(frozen=True)
class Fries:
    """What fries are like: smallest and largest value of each quantity.

    Attributes:
        length: Their length [m].
        section: Their width and thickness [m].
        density: Their density [kg/m3].
    """

    length: tuple[float, float] = (0.050, 0.070)
    section: tuple[float, float] = (0.009, 0.011)
    density: tuple[float, float] = (500, 600)


FRIES = Fries()


def sample_material(rng: np.random.Generator, *, rigid: bool) -> Material:
    """Draw an item's material: E log-uniform from 5e3 to 1e6 Pa, or from 1e8 to 1e9 Pa if rigid."""
    low, high = (1e8, 1e9) if rigid else (5e3, 1e6)
    modulus = float(np.exp(rng.uniform(np.log(low), np.log(high))))
    return Material(float(rng.uniform(1000, 1100)), max(modulus, low), float(rng.uniform(0.2, 0.45)))


def sample_item(rng: np.random.Generator, grid: Grid, *, kind: str | None = None, rigid: bool | None = None) -> Item:
    """Draw an item of any orientation, 1.2 to 2.6 cm thick.

    Args:
        rng: Source of randomness.
        grid: The grid to draw on.
        kind: One of `ITEM_KINDS`, which None draws from, or of `MORE_KINDS`.
        rigid: Whether it is one rigid body; None draws it.
    """
    kind = str(rng.choice(ITEM_KINDS)) if kind is None else kind
    rigid = bool(rng.random() < RIGID_SHARE) if rigid is None else rigid
    taper = rng.uniform(0, 0.15) if rng.random() < 0.5 else 0.0
    direction = rng.uniform(0, 2 * np.pi)
    return draw_item(
        grid,
        _sample_outline(rng, kind),
        thickness=float(rng.uniform(0.012 / (1 - taper), 0.026 / (1 + taper))),
        material=sample_material(rng, rigid=rigid),
        angle=float(rng.uniform(0, 2 * np.pi)),
        taper=(float(taper * np.cos(direction)), float(taper * np.sin(direction))),
    )


def sample_fries(rng: np.random.Generator, plate: Plate, *, layout: str, fries: Fries = FRIES) -> tuple[Box, ...]:
    """Draw 2 to 12 level fries, of about 1 x 1 x 6 cm, that touch neither each other nor the plate.

    Each lies 1 mm above the highest thing below it, so that it falls little when it is settled.

    Args:
        rng: Source of randomness.
        plate: The plate below.
        layout: One of `LAYOUTS` or `MORE_LAYOUTS`.
        fries: What they are like.
    """
    boxes: list[Box] = []
    for x, y in _sample_places(rng, layout):
        section = rng.uniform(*fries.section)
        size = np.array([rng.uniform(*fries.length), section, section])
        yaw = rng.uniform(0, np.pi)
        along, across = np.meshgrid(
            np.linspace(-0.5, 0.5, 41) * (size[0] + 0.004), np.linspace(-0.5, 0.5, 9) * (size[1] + 0.004)
        )
        below_x = x + np.cos(yaw) * along - np.sin(yaw) * across
        below_y = y + np.sin(yaw) * along + np.cos(yaw) * across
        highest = plate.height(np.hypot(below_x, below_y)).max()
        for box in (box for box in boxes if np.hypot(box.position[0] - x, box.position[1] - y) < 0.075):
            highest = max(highest, box.top(below_x, below_y).max())
        position = np.array([x, y, highest + section / 2 + 0.001])
        orientation = np.array([0, 0, np.sin(yaw / 2), np.cos(yaw / 2)])
        boxes.append(Box(size, position, orientation, Material(float(rng.uniform(*fries.density)), 1e6, 0.3)))
    return tuple(boxes)


def sample_scene(
    rng: np.random.Generator,
    grid: Grid,
    *,
    settle: Settler,
    layout: str | None = None,
    plate: Plate | None = None,
    fries: Fries = FRIES,
) -> Scene:
    """Draw fries, let them settle on a plate, by default the dinner plate, and draw again if one fell off or moves.

    Raises:
        ModelError: No draw came to rest on the plate.
    """
    plate = dinner_plate() if plate is None else plate
    reason = ""
    for _ in range(ATTEMPTS):
        drawn = sample_fries(rng, plate, layout=str(rng.choice(LAYOUTS)) if layout is None else layout, fries=fries)
        try:
            boxes = settle(plate, drawn)
        except ModelError as error:
            reason = str(error)
            continue
        if all(np.hypot(*box.position[:2]) < RIM_RADIUS for box in boxes):
            return render_scene(grid, Bodies(plate, boxes))
        reason = "a fry fell off the plate"
    raise ModelError(f"expected fries at rest on the plate within {ATTEMPTS} draws, the last failed: {reason}")


def sample_state(rng: np.random.Generator, grid: Grid, *, settle: Settler) -> State:
    """Draw a settled scene and an item."""
    return State(sample_scene(rng, grid, settle=settle), sample_item(rng, grid))


def sample_action(rng: np.random.Generator, state: State, *, place: str | None = None) -> NDArray[np.float64]:
    """Draw an action ``(2,)`` [m] within the task's bounds.

    Args:
        rng: Source of randomness.
        state: Scene and item.
        place: One of `PLACES`; None draws it. ``anywhere`` is the plate's flat, ``heap_edge`` puts a random point of
            the item over the edge of the visible fries, ``rim`` its far end over the slope or the rim, ``bare``
            the whole item beside the fries. Where the state leaves no such action, it is ``anywhere``.
    """
    if place is None:
        place = str(rng.choice(list(PLACES), p=list(PLACES.values())))
    if place not in PLACES:
        raise RequestError(f"expected a place of {', '.join(PLACES)}, got {place!r}")
    action = find_action(rng, state, place=place)
    if action is not None:
        return action
    low, high = Plating().bounds(state).T
    while True:
        action = rng.uniform(low, high)
        if np.hypot(*action) <= FLAT_RADIUS:
            return action


def find_action(rng: np.random.Generator, state: State, *, place: str) -> NDArray[np.float64] | None:
    """Draw an action at a place as in `sample_action`, or return None where the state leaves no such action."""
    low, high = Plating().bounds(state).T
    for _ in range(10 * ATTEMPTS):
        action = _propose_action(rng, state, place)
        if action is None:
            return None
        if (action >= low).all() and (action <= high).all() and np.hypot(*action) <= FLAT_RADIUS:
            return action
    return None


def _propose_action(rng: np.random.Generator, state: State, place: str) -> NDArray[np.float64] | None:
    """Return a candidate that may lie out of bounds, or None where the place cannot be had."""
    fries = state.scene.materials[0] > 0
    points = _points(state.grid, state.item.outline)
    if place == "heap_edge":
        inner = fries.copy()
        for axis in (0, 1):
            inner &= np.roll(fries, 1, axis) & np.roll(fries, -1, axis)
        edge = _points(state.grid, fries & ~inner)
        return rng.choice(edge) - rng.choice(points) if len(edge) else None
    if place == "rim":
        angle = rng.uniform(0, 2 * np.pi)
        direction = np.array([np.cos(angle), np.sin(angle)])
        return direction * (rng.uniform(FLAT_RADIUS + 0.01, RIM_RADIUS + 0.01) - (points @ direction).max())
    action = rng.uniform(-FLAT_RADIUS, FLAT_RADIUS, 2)
    if place == "bare" and not _is_bare(state, points + action):
        return np.array([np.inf, np.inf])
    return action


def _is_bare(state: State, points: NDArray[np.float64]) -> bool:
    """Return whether all points ``(N, 2)`` lie on the plate's flat with no fry at them."""
    cells = np.rint((points - (state.grid.x[0], state.grid.y[0])) / state.grid.cell).astype(int)
    columns, rows = cells[:, 0].clip(0, state.grid.columns - 1), cells[:, 1].clip(0, state.grid.rows - 1)
    on_flat = (np.hypot(*points.T) <= FLAT_RADIUS + 0.01).all()
    return bool(on_flat and not state.scene.materials[0, rows, columns].any())


def _points(grid: Grid, mask: NDArray[np.bool_]) -> NDArray[np.float64]:
    """Return the centres of the cells of a mask ``(N, 2)`` [m]."""
    rows, columns = np.nonzero(mask)
    return np.stack([grid.x[columns], grid.y[rows]], axis=1)


def _sample_outline(rng: np.random.Generator, kind: str) -> Outline:
    scale = rng.uniform(0.85, 1.05)
    length, width = 0.14 * scale, 0.09 * scale * rng.uniform(0.85, 1.1)
    if kind == "steak":
        return RoundedRectangle(length, width, float(rng.uniform(0.010, 0.030)))
    if kind == "ellipse":
        return Wavy(length, width)
    if kind == "irregular":
        return Wavy(
            0.92 * length,
            width,
            tuple(rng.uniform(-1, 1, 4) * np.array([0.08, 0.08, 0.05, 0.03])),
            tuple(rng.uniform(0, 2 * np.pi, 4)),
        )
    if kind == "t_bone":
        return TwoLobes(length, width, float(rng.uniform(0.3, 0.45)))
    if kind == "medallion":
        diameter = rng.uniform(0.055, 0.075)
        return Wavy(diameter, diameter * rng.uniform(0.85, 1.0), (rng.uniform(0, 0.04),), (rng.uniform(0, np.pi),))
    if kind == "slice":
        return RoundedRectangle(0.58 * length, 0.55 * width, float(rng.uniform(0.006, 0.015)))
    raise RequestError(f"expected an item of {', '.join(ITEM_KINDS + MORE_KINDS)}, got {kind!r}")


def _sample_places(rng: np.random.Generator, layout: str) -> NDArray[np.float64]:
    """Draw the centres of 2 to 12 fries ``(N, 2)``, at most 7.5 cm from the plate's centre [m]."""
    if layout == "heap":
        places = _around(rng, _on_disc(rng, 0.0, 0.025), int(rng.integers(6, 13)), 0.022)
    elif layout == "side_heap":
        places = _around(rng, _on_disc(rng, 0.045, 0.060), int(rng.integers(4, 10)), 0.016)
    elif layout == "small_heaps":
        counts = [int(rng.integers(2, 4)) for _ in range(rng.integers(2, 4))]
        places = np.concatenate([_around(rng, _on_disc(rng, 0.035, 0.065), count, 0.008) for count in counts])
    elif layout == "scattered":
        places = np.stack([_on_disc(rng, 0.0, 0.075) for _ in range(rng.integers(4, 10))])
    elif layout == "lone_heap":
        places = _around(rng, _on_disc(rng, 0.058, 0.070), int(rng.integers(2, 5)), 0.007)
    else:
        raise RequestError(f"expected a layout of {', '.join(LAYOUTS + MORE_LAYOUTS)}, got {layout!r}")
    return places * np.minimum(1, 0.075 / np.maximum(np.hypot(*places.T), 1e-9))[:, None]


def _around(rng: np.random.Generator, centre: NDArray[np.float64], count: int, spread: float) -> NDArray[np.float64]:
    return centre + rng.normal(0, spread, (count, 2))


def _on_disc(rng: np.random.Generator, inner: float, outer: float) -> NDArray[np.float64]:
    radius, angle = np.sqrt(rng.uniform(inner**2, outer**2)), rng.uniform(0, 2 * np.pi)
    return radius * np.array([np.cos(angle), np.sin(angle)])
