"""The training data of the paper's learned model: whole heightmaps, and how the item changed them."""

from dataclasses import dataclass

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Generator, Tensor, nn

from common.domain.grid import Grid
from common.learning.features import HEIGHT_SCALE
from common.storage.dataset import Samples
from services.learned.encoder_decoder import encoder_inputs, mean_squared_error


@dataclass(frozen=True)
class Images:
    """N samples.

    Attributes:
        inputs: What the network sees ``(N, 4, H, W)``.
        changes: What it shall answer ``(N, H, W)``, in units of `HEIGHT_SCALE`.
        groups: Number of the state ``(N,)``.
        grid: The grid.
    """

    inputs: Tensor
    changes: Tensor
    groups: NDArray[np.int64]
    grid: Grid

    @classmethod
    def of(cls, samples: Samples, grid: Grid) -> "Images":
        """Return samples as the network sees them."""
        changes = torch.from_numpy((samples.outcomes - samples.scene_heights) / np.float32(HEIGHT_SCALE))
        inputs = encoder_inputs(samples.scene_heights, samples.item_heights, samples.actions, grid)
        return cls(inputs, changes, samples.groups, grid)

    def loss(self, network: nn.Module, indices: Tensor, generator: Generator | None) -> Tensor:
        """Return the mean squared error; nothing is turned or mirrored."""
        del generator
        return mean_squared_error(network, self.inputs[indices], self.changes[indices])
