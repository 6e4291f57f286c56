"""The learned model's training data: windows around the actions, and what the heuristic sum gets wrong in them."""

from dataclasses import dataclass

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Generator, Tensor, nn

from common.domain.grid import Grid
from common.learning.features import SYMMETRIES, transform
from common.storage.dataset import Samples
from services.learned.windows import Views, residuals

FLOOR = 0.02
"""Error below which a sample counts little, in units of `HEIGHT_SCALE`."""


@dataclass(frozen=True)
class Windows:
    """N windows.

    Attributes:
        inputs: What the network sees ``(N, 12, S, S)``.
        residuals: What it shall answer ``(N, S, S)``, in units of `HEIGHT_SCALE`.
        groups: Number of the state ``(N,)``.
        grid: The grid that they are cut out of.
    """

    inputs: Tensor
    residuals: Tensor
    groups: NDArray[np.int64]
    grid: Grid

    @classmethod
    def of(cls, samples: Samples, grid: Grid, *, size: int) -> "Windows":
        """Cut windows with an edge of ``size`` cells out of samples."""
        views = Views.of(samples.scene_heights, samples.scene_materials, samples.item_heights, samples.item_materials)
        inputs, first = views.inputs(samples.actions, grid, size)
        return cls(inputs, residuals(inputs, first, samples.outcomes, samples.scene_heights), samples.groups, grid)

    def loss(self, network: nn.Module, indices: Tensor, generator: Generator | None) -> Tensor:
        """Return the mean over the samples of their root mean squared errors, the measure of Table I.

        Samples that are easy count more than in a mean squared error, and those that nobody can predict count less.
        With a generator each sample is turned and mirrored as it says.
        """
        inputs, expected = self.inputs[indices], self.residuals[indices]
        if generator is not None:
            drawn = torch.randint(SYMMETRIES, (len(indices),), generator=generator).tolist()
            inputs = torch.stack([transform(one, symmetry) for one, symmetry in zip(inputs, drawn, strict=True)])
            expected = torch.stack([transform(one, symmetry) for one, symmetry in zip(expected, drawn, strict=True)])
        answer = network(inputs.contiguous(memory_format=torch.channels_last))
        squared = ((answer - expected) ** 2).mean(dim=(1, 2))
        return (squared + FLOOR**2).sqrt().mean()
