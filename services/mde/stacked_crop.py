"""The members of an ensemble of `CropNetwork` computed together, in a third of the time that they take in turn."""

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor, nn
from torch.nn import functional

from common.learning.features import centred_first
from services.mde.network import NARROWEST, Encoding
from services.mde.network_crop import GROUPS, CropNetwork


class StackedCrop:
    """K trained members: their channels lie side by side, and convolutions are grouped.

    Args:
        members: The networks, in evaluation mode.
        means: Mean of each member's descriptions ``(K, F)``.
        whitenings: What makes them white ``(K, F, F)``.
        limits: Largest familiar distance of each ``(K,)``.
    """

    def __init__(self, members: list[CropNetwork], means: Tensor, whitenings: Tensor, limits: Tensor) -> None:
        self._members = members
        self._count = len(members)
        self._size, self._coarse = members[0].size, members[0].coarse
        self._joint = [self._layer(index) for index in range(1, len(members[0].joint), 3)]
        heads, lasts = [_linear(member.head[1]) for member in members], [member.last for member in members]
        self._head = _stacked(heads)
        self._last = _stacked(lasts)
        self._mean = means[:, None]
        self._whiten = (whitenings / limits[:, None, None]).transpose(1, 2).contiguous()

    def encode(self, scene: Tensor, item: Tensor) -> Encoding:
        """Return the feature maps of one state's scene ``(1, K C, h, w)`` and item ``(1, K C, size, size)``."""
        parts = [member.encode(scene, item) for member in self._members]
        return torch.cat([part[0] for part in parts], dim=1), torch.cat([part[1] for part in parts], dim=1)

    def estimate(self, encoding: Encoding, actions: NDArray[np.float64]) -> tuple[Tensor, Tensor, Tensor]:
        """Return medians, gaps and distances, 1 at the limit, ``(K, B)`` each, for actions ``(B, 2)`` [m]."""
        scene, item = encoding
        seen = functional.relu(_windows(scene, centred_first(actions, self._coarse, self._size), self._size) + item)
        for weight, bias, scale, offset in self._joint:
            seen = functional.conv2d(seen, weight, bias, stride=2, padding=1, groups=self._count)
            seen = functional.relu(functional.group_norm(seen, GROUPS * self._count, scale, offset))
        pooled = [part.reshape(len(seen), self._count, -1) for part in (seen.mean(dim=(2, 3)), seen.amax(dim=(2, 3)))]
        descriptions = functional.relu(_apply(self._head, torch.cat(pooled, dim=2).transpose(0, 1)))
        median, gap = _apply(self._last, descriptions).unbind(dim=2)
        distance = torch.linalg.vector_norm(torch.bmm(descriptions - self._mean, self._whiten), dim=2)
        return median, functional.softplus(gap) + NARROWEST, distance

    def _layer(self, index: int) -> tuple[Tensor, Tensor, Tensor, Tensor]:
        """Return weight and bias of a convolution, scale and offset of its normalisation, of all members."""
        pairs = [(member.joint[index], member.joint[index + 1]) for member in self._members]
        parts = [(conv.weight, conv.bias, norm.weight, norm.bias) for conv, norm in pairs]
        weight, bias, scale, offset = (torch.cat(values) for values in zip(*parts, strict=True))  # type: ignore[arg-type]
        return weight, bias, scale, offset


def _linear(module: nn.Module) -> nn.Linear:
    assert isinstance(module, nn.Linear)
    return module


def _stacked(layers: list[nn.Linear]) -> tuple[Tensor, Tensor]:
    return torch.stack([layer.weight.T for layer in layers]), torch.stack([layer.bias[None] for layer in layers])


def _apply(layer: tuple[Tensor, Tensor], values: Tensor) -> Tensor:
    weight, bias = layer
    return torch.baddbmm(bias, values, weight)


def _windows(image: Tensor, first: NDArray[np.float64], size: int) -> Tensor:
    """Cut windows out of one image, as `common.learning.features.window` does: ``(1, C, h, w)`` -> ``(B, C, s, s)``."""
    rows, columns = image.shape[-2:]
    steps = np.arange(size)
    x = (first[:, 0, None] + steps) * (2 / (columns - 1)) - 1
    y = (first[:, 1, None] + steps) * (2 / (rows - 1)) - 1
    shape = (len(first), size, size)
    places = np.stack([np.broadcast_to(x[:, None, :], shape), np.broadcast_to(y[:, :, None], shape)], axis=-1)
    return functional.grid_sample(
        image.expand(len(first), -1, -1, -1),
        torch.from_numpy(places.astype(np.float32)),
        align_corners=True,
        padding_mode="border",
    )
