"""What the network sees: scene and shifted item in a window around the action, and two guesses of what will be.

An item that does not bend comes to rest on a plane. Its centre of mass stays above the same point, so that a tilt
moves its upper surface down the slope by half of its thickness times the slope. One that bends lies as low as its
stiffness lets it, see `common.learning.draping`.
"""

from dataclasses import dataclass

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from common.domain.grid import Floats, Grid
from common.learning.draping import bending_length, draped
from common.learning.features import (
    DENSITY_SCALE,
    HEIGHT_SCALE,
    MODULUS_CENTRE,
    MODULUS_SCALE,
    channels,
    item_first,
    whole_first,
    window,
)
from common.learning.support import resting_plane

FARTHEST = 3.0
"""How far the top of a tilted item moves at most, along x and along y [cells]."""

HIGHEST = 6.0
"""Largest correction that an unbending item would need, as the network sees it, in units of `HEIGHT_SCALE`."""


@dataclass(frozen=True)
class Views:
    """Scaled channels of scenes and items ``(B, 5, H, W)``, or of one of each ``(1, 5, H, W)``."""

    scene: Tensor
    item: Tensor

    @classmethod
    def of(
        cls, scene_heights: Floats, scene_materials: Floats, item_heights: Floats, item_materials: Floats
    ) -> "Views":
        """Return the channels of heightmaps ``(B, H, W)`` [m] and materials ``(B, 3, H, W)``."""
        return cls(channels(scene_heights, scene_materials), channels(item_heights, item_materials))

    def inputs(self, actions: Floats, grid: Grid, size: int) -> tuple[Tensor, NDArray[np.int64]]:
        """Return windows ``(B, 12, S, S)`` for actions ``(B, 2)`` [m], and the windows' first cells ``(B, 2)``."""
        first = whole_first(actions, grid, size)
        scene = window(self.scene, torch.from_numpy(first), size)
        of_item = item_first(actions, grid, first)
        item = window(self.item, torch.from_numpy(of_item), size, outside="zero")
        slopes, planes = _planes(scene, item)
        thickness = _mean_thickness(item)
        moved = np.clip(-0.5 * thickness[:, None] * slopes / (grid.cell / HEIGHT_SCALE) ** 2, -FARTHEST, FARTHEST)
        tilted = window(self.item[:, :2], torch.from_numpy(of_item - moved), size, outside="zero")
        height, mask = tilted.unbind(1)
        unbending = mask * (planes - scene[:, 0]) + height - item[:, 0]
        guesses = torch.stack([unbending, _bending(scene, item, grid.cell)], dim=1).clamp(-HIGHEST, HIGHEST)
        return torch.cat([scene, item, guesses], dim=1), first.astype(np.int64)


def _planes(scene: Tensor, item: Tensor) -> tuple[NDArray[np.float64], Tensor]:
    """Return slopes ``(B, 2)`` and heights ``(B, S, S)`` of the planes on which unbending items rest."""
    heights, outlines = scene[:, 0].numpy(), item[:, 1].numpy() > 0.5
    masses = (item[:, 0] * item[:, 2]).numpy()
    found = np.array([resting_plane(*one) for one in zip(heights, outlines, masses, strict=True)])
    rows, columns = np.mgrid[: heights.shape[1], : heights.shape[2]]
    slope_x, slope_y, offset = (number[:, None, None] for number in found.T)
    return found[:, :2], torch.from_numpy((slope_x * columns + slope_y * rows + offset).astype(np.float32))


def _bending(scene: Tensor, item: Tensor, cell: float) -> Tensor:
    """Return how far items that bend as their material does lie above the scenes ``(B, S, S)``."""
    lifts = []
    for below, (thickness, mask, density, modulus, _) in zip(scene[:, 0].numpy(), item.numpy(), strict=True):
        outline = mask > 0.5
        if not outline.any():
            lifts.append(np.zeros_like(below))
            continue
        length = bending_length(
            10 ** (MODULUS_CENTRE + MODULUS_SCALE * float(modulus[outline].mean())),
            DENSITY_SCALE * float(density[outline].mean()),
            HEIGHT_SCALE * float(thickness[outline].mean()),
        )
        lifts.append(draped(below, outline, cell**2 / (4 * length) / HEIGHT_SCALE) - below)
    return torch.from_numpy(np.stack(lifts))


def _mean_thickness(item: Tensor) -> NDArray[np.float64]:
    inside = item[:, 1] > 0.5
    count = inside.sum(dim=(1, 2)).clamp(min=1)
    return ((item[:, 0] * inside).sum(dim=(1, 2)) / count).double().numpy()


def residuals(inputs: Tensor, first: NDArray[np.int64], outcomes: Floats, scene_heights: Floats) -> Tensor:
    """Return what the heuristic sum gets wrong in each window ``(B, S, S)``, in units of `HEIGHT_SCALE`.

    Args:
        inputs: ``(B, 12, S, S)``.
        first: First cells ``(B, 2)``.
        outcomes: Heightmaps ``(B, H, W)`` [m].
        scene_heights: Heightmaps before ``(B, H, W)`` [m]; where a window leaves the grid nothing changes.
    """
    size = inputs.shape[-1]
    change = torch.from_numpy((np.asarray(outcomes) - scene_heights)[:, None] / np.float32(HEIGHT_SCALE))
    return window(change, torch.from_numpy(first.astype(np.float64)), size, outside="zero")[:, 0] - inputs[:, 5]
