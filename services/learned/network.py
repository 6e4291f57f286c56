"""A residual encoder-decoder: what the heuristic sum gets wrong, seen through a window around the action."""

from dataclasses import dataclass

import torch
from torch import Tensor, nn
from torch.nn import functional

from common.domain.grid import Grid
from common.learning.features import CHANNELS

GUESSES = 2
"""What an unbending item and one that bends would correct."""

INPUTS = 2 * len(CHANNELS) + GUESSES
"""Channels of the input: those of the scene, those of the shifted item, and the guesses."""


@dataclass(frozen=True)
class NetworkSettings:
    """Size of the network.

    Attributes:
        window: Edge of the window around the action, a multiple of 8 [cells].
        widths: Channels at a half, a quarter and an eighth of the resolution.
        blocks: Residual blocks at an eighth of the resolution.
        item_reach: Cells beyond the item's outline that may change.
        fry_reach: Cells beyond what lies in the scene that may change.
    """

    window: int = 64
    widths: tuple[int, int, int] = (32, 64, 128)
    blocks: int = 2
    item_reach: int = 4
    fry_reach: int = 8

    def __post_init__(self) -> None:
        sizes = (self.window, *self.widths, self.blocks, self.item_reach, self.fry_reach)
        if len(self.widths) != 3 or any(type(size) is not int or not 0 <= size <= 1024 for size in sizes):
            raise ValueError(f"expected three widths, and whole numbers from 0 to 1024, got {self}")
        if self.window % 8 or not self.window or not all(self.widths):
            raise ValueError(f"expected a window of a multiple of 8 cells and widths above 0, got {self}")


class ResidualNetwork(nn.Module):
    """Encoder and decoder with skips between equal resolutions: a share of each guess, and a rest; untrained 0.

    The guesses are the input's last channels: how far an item that does not bend, and one that bends, would be from the
    heuristic sum.

    The answer is exactly 0 further than ``item_reach`` from the item and ``fry_reach`` from everything that lies in
    the scene: nothing there can move.

    Attributes:
        facts: Rows, columns and cell [m] of the grid that it is trained on, float64 ``(3,)``.
    """

    facts: Tensor

    def __init__(self, settings: NetworkSettings, grid: Grid) -> None:
        super().__init__()
        self.settings = settings
        self.register_buffer("facts", torch.tensor([grid.rows, grid.columns, grid.cell], dtype=torch.float64))
        half, quarter, eighth = settings.widths
        self.entry = nn.Conv2d(4 * INPUTS, half, 3, padding=1)
        self.encode_half = Block(half)
        self.to_quarter = nn.Conv2d(half, quarter, 2, stride=2)
        self.encode_quarter = Block(quarter)
        self.to_eighth = nn.Conv2d(quarter, eighth, 2, stride=2)
        self.middle = nn.Sequential(*(Block(eighth) for _ in range(settings.blocks)))
        self.from_eighth = nn.ConvTranspose2d(eighth, quarter, 2, stride=2)
        self.decode_quarter = Block(quarter)
        self.from_quarter = nn.ConvTranspose2d(quarter, half, 2, stride=2)
        self.decode_half = Block(half)
        self.exit = nn.Conv2d(half, 4 * (GUESSES + 1), 3, padding=1)
        nn.init.zeros_(self.exit.weight)
        nn.init.zeros_(self.exit.bias)  # type: ignore[arg-type]

    @property
    def grid(self) -> Grid:
        """The grid that it is trained on."""
        rows, columns, cell = self.facts.tolist()
        return Grid(int(rows), int(columns), cell)

    def forward(self, inputs: Tensor) -> Tensor:
        """Return the residuals ``(B, S, S)`` for windows ``(B, 12, S, S)``, in units of `HEIGHT_SCALE`."""
        half = self.encode_half(functional.silu(self.entry(functional.pixel_unshuffle(inputs, 2))))
        quarter = self.encode_quarter(functional.silu(self.to_quarter(half)))
        eighth = self.middle(functional.silu(self.to_eighth(quarter)))
        quarter = self.decode_quarter(functional.silu(self.from_eighth(eighth) + quarter))
        half = self.decode_half(functional.silu(self.from_quarter(quarter) + half))
        answer = functional.pixel_shuffle(self.exit(half), 2)
        shares, rest = answer[:, :GUESSES], answer[:, GUESSES]
        return ((shares * inputs[:, -GUESSES:]).sum(dim=1) + rest) * self.can_change(inputs)

    def can_change(self, inputs: Tensor) -> Tensor:
        """Return 1 where the outcome may differ from the heuristic sum, else 0 ``(B, S, S)``."""
        scene, item = inputs[:, 1:2], inputs[:, len(CHANNELS) + 1 : len(CHANNELS) + 2]
        near = torch.maximum(_grow(scene, self.settings.fry_reach), _grow(item, self.settings.item_reach))
        return (near[:, 0] > 0).to(inputs.dtype)


class Block(nn.Module):
    """Two convolutions around which the input is carried; untrained it is the identity."""

    def __init__(self, width: int) -> None:
        super().__init__()
        self.first = nn.Conv2d(width, width, 3, padding=1)
        self.second = nn.Conv2d(width, width, 3, padding=1)
        self.scale = nn.Parameter(torch.zeros(width, 1, 1))

    def forward(self, values: Tensor) -> Tensor:
        """Return ``values + scale * second(silu(first(silu(values))))``, same shape."""
        return values + self.scale * self.second(functional.silu(self.first(functional.silu(values))))


def _grow(mask: Tensor, cells: int) -> Tensor:
    """Return the largest value within so many rows and columns, same shape."""
    along_rows = functional.max_pool2d(mask.contiguous(), (2 * cells + 1, 1), stride=1, padding=(cells, 0))
    return functional.max_pool2d(along_rows, (1, 2 * cells + 1), stride=1, padding=(0, cells))
