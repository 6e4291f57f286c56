"""The paper's architecture: separate encoders for scene and item with their masks, an embedding of the action."""

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor, nn

from common.domain.grid import Grid
from services.mde.network import DeviationNetwork, Encoding, convolution

ACTION_SCALE = 0.08
"""Actions are seen in units of this [m]."""


class PaperNetwork(DeviationNetwork):
    """Fig. 3, right: ``fully_connected(encoder(scene), encoder(item), embedding(action))``, trained with L1.

    The paper gives no sizes; these are four strided convolutions an encoder.

    Args:
        grid: The grid of the states.
        channels: Channels of the four convolutions.
        embedding: Length of each encoder's embedding.
        width: Width of the fully connected layers.
    """

    pooling = 1
    symmetric = False
    bounded = False

    def __init__(
        self, grid: Grid, *, channels: tuple[int, ...] = (16, 32, 32, 64), embedding: int = 128, width: int = 128
    ) -> None:
        super().__init__(grid, features=width)
        self.scene = _encoder(grid, channels, embedding)
        self.item = _encoder(grid, channels, embedding)
        self.action = nn.Sequential(nn.Linear(2, 32), nn.ReLU())
        self.head = nn.Sequential(nn.Linear(2 * embedding + 32, width), nn.ReLU(), nn.Linear(width, width), nn.ReLU())

    def encode(self, scene: Tensor, item: Tensor) -> Encoding:
        """Return the embeddings of scene and item, side by side ``(S, 2 E)``."""
        return (torch.cat([self.scene(scene), self.item(item)], dim=1),)

    def describe(self, encoding: Encoding, actions: NDArray[np.float64]) -> Tensor:
        """Return the last hidden layer ``(B, F)``."""
        (embedding,) = encoding
        action = self.action(torch.from_numpy((actions / ACTION_SCALE).astype(np.float32)))
        return self.head(torch.cat([embedding.expand(len(action), -1), action], dim=1))


def _encoder(grid: Grid, channels: tuple[int, ...], embedding: int) -> nn.Sequential:
    layers: list[nn.Module] = []
    come, rows, columns = 5, grid.rows, grid.columns
    for go in channels:
        layers += [convolution(come, go, stride=2), nn.ReLU()]
        come, rows, columns = go, -(-rows // 2), -(-columns // 2)
    return nn.Sequential(*layers, nn.Flatten(), nn.Linear(come * rows * columns, embedding), nn.ReLU())
