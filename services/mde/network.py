"""What the networks of all MDEs share: what depends on the state is encoded once, the rest runs for each action."""

from abc import ABC, abstractmethod

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor, nn
from torch.nn import functional

from common.domain.grid import Floats, Grid
from common.learning.features import channels

Encoding = tuple[Tensor, ...]
"""What a network keeps of S states; the first dimension of each tensor is S."""

NARROWEST = 0.02
"""Smallest distance from the median to the raw upper bound, on the scale of [0, 1]."""


class DeviationNetwork(nn.Module, ABC):
    """Estimates median and raw upper bound of the deviation of one model, scaled to [0, 1].

    A subclass encodes states and describes actions in them; the last layer turns a description into the estimate.

    Attributes:
        grid: The grid of the states.
        pooling: Cells of the grid along each edge of a cell that the network sees.
        symmetric: Whether training turns and mirrors the samples.
        bounded: Whether the network has a raw upper bound of its own; without, it is a constant above the median.

    Args:
        grid: The grid of the states.
        features: Length of an action's description.
    """

    pooling: int
    symmetric: bool
    bounded: bool

    def __init__(self, grid: Grid, *, features: int) -> None:
        super().__init__()
        self.grid = grid
        self.last = nn.Linear(features, 2)

    @abstractmethod
    def encode(self, scene: Tensor, item: Tensor) -> Encoding:
        """Encode states from the `inputs` of scene and item, each ``(S, 5, H / pooling, W / pooling)``."""

    @abstractmethod
    def describe(self, encoding: Encoding, actions: NDArray[np.float64]) -> Tensor:
        """Return descriptions ``(B, F)`` of actions ``(B, 2)`` [m], in one state (S = 1) or one each (S = B)."""

    def estimate(self, descriptions: Tensor) -> tuple[Tensor, Tensor]:
        """Return the median and its distance to the raw upper bound, ``(B,)`` each, from descriptions ``(B, F)``."""
        return self.read(self.last(descriptions))

    def read(self, outputs: Tensor) -> tuple[Tensor, Tensor]:
        """Return the median and its distance to the raw upper bound ``(...)`` from the last layer's ``(..., 2)``."""
        median, gap = outputs.unbind(dim=-1)
        if not self.bounded:
            return median, torch.ones_like(median)
        return median, functional.softplus(gap) + NARROWEST


def inputs(heights: Floats, materials: Floats, pooling: int) -> Tensor:
    """Return the channels of heights ``(N, H, W)`` and materials ``(N, 3, H, W)`` as a network sees them.

    The mean of each block of ``pooling`` x ``pooling`` cells, ``(N, 5, H / pooling, W / pooling)``.
    """
    seen = channels(heights, materials)
    return seen if pooling == 1 else functional.avg_pool2d(seen, pooling)


def convolution(come: int, go: int, *, kernel: int = 3, stride: int = 1) -> nn.Conv2d:
    """Return a convolution whose output has the size of its input divided by the stride."""
    return nn.Conv2d(come, go, kernel, stride=stride, padding=kernel // 2)
