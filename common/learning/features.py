"""From states to the scaled channels that networks see: windows around an action, the plate's symmetries.

Everything is batched and works on torch tensors; positions are in cells, as ``(column, row)`` of the grid's indices.
"""

from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from common.domain.grid import Floats, Grid

HEIGHT_SCALE = 0.01
"""Heights are seen in units of this [m]."""

DENSITY_SCALE = 1000.0
"""Densities are seen in units of this [kg/m3]."""

MODULUS_CENTRE, MODULUS_SCALE = 5.0, 2.0
"""Young's modulus is seen as ``(log10(E / Pa) - centre) / scale``."""

POISSON_SCALE = 0.5
"""Poisson's ratios are seen in units of this [-]."""

CHANNELS = ("height", "mask", "density", "modulus", "poisson")
"""The channels of `channels`, in order; the last four are 0 where there is only plate."""

SYMMETRIES = 8
"""Number of symmetries of the plate and the grid: four quarter turns, with and without a mirror."""


def channels(heights: Floats, materials: Floats) -> Tensor:
    """Return scaled channels ``(..., 5, H, W)`` float32 in the order of `CHANNELS`.

    Args:
        heights: Heightmaps ``(..., H, W)`` [m].
        materials: Density, Young's modulus, Poisson's ratio ``(..., 3, H, W)``.
    """
    density, modulus, poisson = np.moveaxis(materials, -3, 0)
    mask = modulus > 0
    logarithm = np.log10(np.where(mask, modulus, 1.0))
    seen = (
        heights / HEIGHT_SCALE,
        mask,
        density / DENSITY_SCALE,
        np.where(mask, (logarithm - MODULUS_CENTRE) / MODULUS_SCALE, 0.0),
        poisson / POISSON_SCALE,
    )
    return torch.from_numpy(np.stack(seen, axis=-3).astype(np.float32))


def window(images: Tensor, first: Tensor, size: int, *, outside: str = "edge") -> Tensor:
    """Cut a square window out of each image, bilinear between cells and exact at whole ones.

    Args:
        images: ``(B, C, H, W)``, or ``(1, C, H, W)`` for B windows of one image.
        first: Where the window's first cell lies in the image ``(B, 2)`` float64, column and row [cells].
        size: Edge of the window [cells].
        outside: What is outside of the image: ``edge`` repeats its border, ``zero`` is 0.

    Returns:
        ``(B, C, size, size)``.
    """
    whole = torch.floor(first)
    part = (first - whole).to(images.dtype)
    steps = torch.arange(size + 1)
    columns, rows = (whole[:, axis, None].long() + steps for axis in (0, 1))
    height, width = images.shape[-2:]
    batch = torch.zeros(len(first), dtype=torch.long) if len(images) == 1 else torch.arange(len(images))
    near = images[
        batch[:, None, None], :, rows.clamp(0, height - 1)[:, :, None], columns.clamp(0, width - 1)[:, None, :]
    ]  # (B, size + 1, size + 1, C)
    if outside == "zero":
        is_inside = ((rows >= 0) & (rows < height))[:, :, None] & ((columns >= 0) & (columns < width))[:, None, :]
        near = near * is_inside[..., None]
    elif outside != "edge":
        raise ValueError(f"expected outside to be edge or zero, got {outside!r}")
    across, down = part[:, 0, None, None, None], part[:, 1, None, None, None]
    if part.any():
        near = near[:, :-1] * (1 - down) + near[:, 1:] * down
        near = near[:, :, :-1] * (1 - across) + near[:, :, 1:] * across
    return near[:, :size, :size].permute(0, 3, 1, 2).contiguous()


def cells(actions: Floats, grid: Grid) -> NDArray[np.float64]:
    """Return actions ``(B, 2)`` [m] as fractional indices ``(B, 2)``, column and row [cells]."""
    centre = np.array([grid.columns - 1, grid.rows - 1]) / 2
    return np.asarray(actions, dtype=np.float64) / grid.cell + centre


def whole_first(actions: Floats, grid: Grid, size: int) -> NDArray[np.float64]:
    """Return the first cells ``(B, 2)`` of the windows on whole cells whose centres are nearest to the actions."""
    return np.rint(cells(actions, grid) - (size - 1) / 2)


def centred_first(actions: Floats, grid: Grid, size: int) -> NDArray[np.float64]:
    """Return the first cells ``(B, 2)`` of the windows whose centres are exactly at the actions."""
    return cells(actions, grid) - (size - 1) / 2


def item_first(actions: Floats, grid: Grid, first: NDArray[Any]) -> NDArray[np.float64]:
    """Return where the windows ``first`` of a scene begin in the item's own image, once it is shifted to the actions.

    ``window(item, item_first(a, grid, first), size, outside="zero")`` is ``shift(item, a)`` seen through the window,
    and what the grid cuts off of it.
    """
    return first - np.asarray(actions, dtype=np.float64) / grid.cell


def transform(images: Tensor, symmetry: int) -> Tensor:
    """Turn images ``(..., H, W)`` by ``symmetry % 4`` quarter turns, then mirror x if ``symmetry >= 4``.

    A quarter turn takes the point (x, y) to (y, -x).
    """
    turned = torch.rot90(images, symmetry % 4, (-2, -1))
    return turned.flip(-1) if symmetry >= 4 else turned


def transform_actions(actions: NDArray[Any], symmetry: int) -> NDArray[Any]:
    """Move actions ``(..., 2)`` [m] as `transform` moves images about the grid's centre."""
    x, y = actions[..., 0], actions[..., 1]
    for _ in range(symmetry % 4):
        x, y = y, -x
    return np.stack([-x if symmetry >= 4 else x, y], axis=-1)
