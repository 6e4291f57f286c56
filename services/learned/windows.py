"""What the network sees: scene and shifted item in a window around the action."""

from dataclasses import dataclass

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from common.domain.grid import Floats, Grid
from common.learning.features import HEIGHT_SCALE, channels, item_first, whole_first, window
from common.learning.support import resting_gap


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
        """Return windows ``(B, 11, S, S)`` for actions ``(B, 2)`` [m], and the windows' first cells ``(B, 2)``."""
        first = whole_first(actions, grid, size)
        scene = window(self.scene, torch.from_numpy(first), size)
        item = window(self.item, torch.from_numpy(item_first(actions, grid, first)), size, outside="zero")
        return torch.cat([scene, item, _gaps(scene, item)], dim=1), first.astype(np.int64)


def _gaps(scene: Tensor, item: Tensor) -> Tensor:
    heights, outlines = scene[:, 0].numpy(), item[:, 1].numpy() > 0.5
    masses = (item[:, 0] * item[:, 2]).numpy()
    gaps = [
        resting_gap(HEIGHT_SCALE * h, outline, mass) for h, outline, mass in zip(heights, outlines, masses, strict=True)
    ]
    return torch.from_numpy(np.stack(gaps)[:, None] / HEIGHT_SCALE).float()


def residuals(inputs: Tensor, first: NDArray[np.int64], outcomes: Floats, scene_heights: Floats) -> Tensor:
    """Return what the heuristic sum gets wrong in each window ``(B, S, S)``, in units of `HEIGHT_SCALE`.

    Args:
        inputs: ``(B, 11, S, S)``.
        first: First cells ``(B, 2)``.
        outcomes: Heightmaps ``(B, H, W)`` [m].
        scene_heights: Heightmaps before ``(B, H, W)`` [m]; where a window leaves the grid nothing changes.
    """
    size = inputs.shape[-1]
    change = torch.from_numpy((np.asarray(outcomes) - scene_heights)[:, None] / np.float32(HEIGHT_SCALE))
    return window(change, torch.from_numpy(first.astype(np.float64)), size, outside="zero")[:, 0] - inputs[:, 5]
