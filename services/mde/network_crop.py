"""Ours: a feature map of the scene, cut out around the action and laid over the features of the item."""

from itertools import pairwise

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor, nn

from common.domain.errors import RequestError
from common.domain.grid import Grid
from common.learning.features import centred_first, window
from services.mde.network import DeviationNetwork, Encoding, convolution

GROUPS = 4
"""Groups of channels that are normalised together (Wu and He 2018)."""


class CropNetwork(DeviationNetwork):
    """What lies near the item decides, wherever the action is: ``head(joint(crop(f(scene), a) + g(item)))``.

    f and g are computed once a state, at a quarter of the grid's resolution. The window around the action is bilinear
    between cells, so that the estimate is continuous in the action.

    Attributes:
        size: Edge of the window [cells of `coarse`].
        coarse: The grid of the feature map of the scene.

    Args:
        grid: The grid of the states.
        channels: Channels of f and g at a half and at a quarter of the resolution, then of the joint convolutions,
            each of which halves it again.
        features: Length of an action's description.
        size: Edge of the window, in cells of 4 x 4 of the grid's; it has to hold the item.
        dropout: Share of the pooled features that a training step leaves out.

    Raises:
        RequestError: The grid does not consist of blocks of 4 x 4 cells, or is smaller than the window.
    """

    pooling = 2
    symmetric = True
    bounded = True

    def __init__(
        self,
        grid: Grid,
        *,
        channels: tuple[int, ...] = (16, 32, 48, 64),
        features: int = 64,
        size: int = 16,
        dropout: float = 0.1,
    ) -> None:
        super().__init__(grid, features=features)
        if grid.rows % 4 or grid.columns % 4 or min(grid.shape) < 4 * size:
            raise RequestError(f"expected a grid of multiples of 4 cells, {4 * size} at least, got {grid}")
        self.size = size
        self.coarse = Grid(grid.rows // 4, grid.columns // 4, 4 * grid.cell)
        self.scene, self.item = _encoder(*channels[:2]), _encoder(*channels[:2])
        joint: list[nn.Module] = []
        for come, go in pairwise(channels[1:]):
            joint += [convolution(come, go, stride=2), nn.GroupNorm(GROUPS, go), nn.ReLU()]
        self.joint = nn.Sequential(nn.ReLU(), *joint)
        self.head = nn.Sequential(nn.Dropout(dropout), nn.Linear(2 * channels[-1], features), nn.ReLU())

    def encode(self, scene: Tensor, item: Tensor) -> Encoding:
        """Return the feature maps of scene ``(S, C, H / 4, W / 4)`` and item ``(S, C, size, size)``."""
        edge = 2 * self.size
        rows, columns = ((length - edge) // 2 for length in item.shape[-2:])
        return self.scene(scene), self.item(item[:, :, rows : rows + edge, columns : columns + edge])

    def describe(self, encoding: Encoding, actions: NDArray[np.float64]) -> Tensor:
        """Return what the windows around the actions are described by ``(B, F)``."""
        scene, item = encoding
        first = torch.from_numpy(centred_first(actions, self.coarse, self.size))
        seen = self.joint(window(scene, first, self.size) + item)
        return self.head(torch.cat([seen.mean(dim=(2, 3)), seen.amax(dim=(2, 3))], dim=1))


def _encoder(half: int, quarter: int) -> nn.Sequential:
    return nn.Sequential(
        convolution(5, half),
        nn.GroupNorm(GROUPS, half),
        nn.ReLU(),
        convolution(half, quarter, stride=2),
        nn.GroupNorm(GROUPS, quarter),
        nn.ReLU(),
        convolution(quarter, quarter),
    )
