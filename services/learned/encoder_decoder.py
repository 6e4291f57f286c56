"""The paper's learned model: an encoder-decoder that is told the action as numbers, a residual on the scene."""

from dataclasses import asdict, dataclass
from pathlib import Path

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor, nn
from torch.nn import functional

from common.domain.errors import ModelError, RequestError
from common.domain.grid import Floats, Grid
from common.domain.model import PredictiveModel
from common.domain.scene import State
from common.learning.features import HEIGHT_SCALE
from common.learning.training import threads
from common.learning.weights import WeightsCard, load, read_card

ARCHITECTURE = "paper"
GROUPS = 8
INPUTS = 4
"""Channels of the input: the scene's and the item's heights, and where each cell is from the action along x and y."""
DISTANCE_SCALE = 0.05
"""Distances are seen in units of this [m]."""


@dataclass(frozen=True)
class EncoderDecoderSettings:
    """Size of the network: channels at a half, a quarter, an eighth and a sixteenth of the resolution."""

    widths: tuple[int, ...] = (24, 48, 96, 128)


class EncoderDecoder(nn.Module):
    """Heightmaps of scene and item, the item where its own image has it, and the action; no material is seen.

    What it draws at the action it has to know from the item's image or, trained on one item, by heart.

    Attributes:
        facts: Rows, columns and cell [m] of the grid that it is trained on, float64 ``(3,)``.

    Raises:
        RequestError: The grid cannot be halved as often as there are widths.
    """

    facts: Tensor

    def __init__(self, settings: EncoderDecoderSettings, grid: Grid) -> None:
        super().__init__()
        blocks = 2 ** len(settings.widths)
        if grid.rows % blocks or grid.columns % blocks:
            raise RequestError(f"expected a grid of multiples of {blocks} cells, got {grid}")
        self.register_buffer("facts", torch.tensor([grid.rows, grid.columns, grid.cell], dtype=torch.float64))
        down, up, come = [], [], INPUTS
        for width in settings.widths:
            down.append(_layer(nn.Conv2d(come, width, 4, stride=2, padding=1), width))
            come = width
        for width in (*reversed(settings.widths[:-1]), settings.widths[0]):
            up.append(_layer(nn.ConvTranspose2d(come, width, 4, stride=2, padding=1), width))
            come = width
        self.down, self.up = nn.ModuleList(down), nn.ModuleList(up)
        self.exit = nn.Conv2d(come, 1, 3, padding=1)

    @property
    def grid(self) -> Grid:
        """The grid that it is trained on."""
        rows, columns, cell = self.facts.tolist()
        return Grid(int(rows), int(columns), cell)

    def forward(self, inputs: Tensor) -> Tensor:
        """Return the change of the scene ``(B, H, W)`` for inputs ``(B, 4, H, W)``, in units of `HEIGHT_SCALE`."""
        skips, values = [], inputs
        for layer in self.down:
            values = layer(values)
            skips.append(values)
        for layer, skip in zip(self.up, [None, *reversed(skips[:-1])], strict=True):
            values = layer(values if skip is None else values + skip)
        return self.exit(values)[:, 0]


def _layer(convolution: nn.Module, width: int) -> nn.Sequential:
    return nn.Sequential(convolution, nn.GroupNorm(GROUPS, width), nn.SiLU())


def encoder_inputs(scene: Floats, item: Floats, actions: Floats, grid: Grid) -> Tensor:
    """Return what the network sees ``(B, 4, H, W)`` of heightmaps ``(B, H, W)`` [m] and actions ``(B, 2)`` [m]."""
    x = (grid.x[None, None, :] - actions[:, 0, None, None]) / DISTANCE_SCALE
    y = (grid.y[None, :, None] - actions[:, 1, None, None]) / DISTANCE_SCALE
    shape = (len(actions), *grid.shape)
    seen = (scene / HEIGHT_SCALE, item / HEIGHT_SCALE, np.broadcast_to(x, shape), np.broadcast_to(y, shape))
    return torch.from_numpy(np.stack([np.broadcast_to(one, shape) for one in seen], axis=1).astype(np.float32))


class PaperLearnedModel(PredictiveModel):
    """``I_0`` and what the network adds to it.

    Args:
        network: The trained network; its grid is the only one that the model takes.
        version: Version of model and weights.
        weights: SHA-256 of the file of weights, None if they come from none.
    """

    name = "learned"

    def __init__(self, network: EncoderDecoder, *, version: str, weights: str | None = None) -> None:
        self.grid, self.version, self.weights = network.grid, version, weights
        self._network = network.eval().requires_grad_(False)

    @classmethod
    def load(cls, folder: Path) -> "PaperLearnedModel":
        """Return the model with the weights in a folder.

        Raises:
            ModelError: There are none, or they are not what their card says.
        """
        card = read_card(folder, name=cls.name)
        network = EncoderDecoder(_settings(card, folder), card.grid.grid())
        network.load_state_dict(load(folder, network.state_dict(), card=card))
        if network.grid != card.grid.grid():
            raise ModelError(f"{folder}: expected a card with the grid of the weights, got {card.grid.grid()}")
        return cls(network, version=card.version, weights=card.sha256)

    def outcomes(self, state: State, actions: NDArray[np.float64]) -> tuple[Floats, tuple[str, ...]]:
        """Return the predicted heightmaps ``(B, H, W)`` [m].

        Raises:
            RequestError: The state is on another grid than the training data.
        """
        if state.grid != self.grid:
            raise RequestError(f"grid: expected {self.grid} as in the training data, got {state.grid}")
        predicted = []
        with torch.inference_mode(), threads(1):
            for action in actions:  # one at a time, so that an answer does not depend on its batch
                seen = encoder_inputs(state.scene.heights[None], state.item.heights[None], action[None], self.grid)
                change = self._network(seen.contiguous(memory_format=torch.channels_last))[0].numpy()  # a fifth faster
                predicted.append(state.scene.heights + HEIGHT_SCALE * change)
        return np.stack(predicted).astype(np.float32), ("",) * len(actions)


def mean_squared_error(network: nn.Module, inputs: Tensor, expected: Tensor) -> Tensor:
    """Return the mean squared error of predicted changes ``(B, H, W)``, the paper's loss."""
    return functional.mse_loss(network(inputs), expected)


def _settings(card: WeightsCard, folder: Path) -> EncoderDecoderSettings:
    found = card.settings.get("network")
    if not isinstance(found, dict) or found.keys() != asdict(EncoderDecoderSettings()).keys():
        raise ModelError(f"{folder}: expected the network's settings widths, got {found!r:.200}")
    widths = found["widths"]
    if not isinstance(widths, list) or not widths or any(type(one) is not int or one % GROUPS for one in widths):
        raise ModelError(f"{folder}: expected widths that are multiples of {GROUPS}, got {widths!r:.200}")
    return EncoderDecoderSettings(tuple(widths))
