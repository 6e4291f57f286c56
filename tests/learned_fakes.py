"""A learned model with small weights on a small grid."""

from dataclasses import asdict
from pathlib import Path

from torch import nn

from common.domain.grid import Grid
from common.learning.training import seeded
from common.learning.weights import DatasetCard, GridCard, WeightsCard, save
from services.learned.model import ARCHITECTURE
from services.learned.network import NetworkSettings, ResidualNetwork

GRID = Grid(48, 48, 0.005)
SIZE = NetworkSettings(window=32, widths=(8, 8, 8), blocks=1)


def make_network(std: float, grid: Grid = GRID) -> ResidualNetwork:
    """Return a network whose last layer is drawn with this standard deviation."""
    with seeded(0):
        network = ResidualNetwork(SIZE, grid)
        nn.init.normal_(network.exit.weight, std=std)
    return network


def save_learned(folder: Path, *, std: float = 0.3, grid: Grid = GRID) -> WeightsCard:
    """Write weights and card, version 7."""
    card = WeightsCard(
        name="learned",
        version="7",
        architecture=ARCHITECTURE,
        dataset=DatasetCard(name="toy", seed=0, version="1", samples=10),
        grid=GridCard.of(grid),
        seed=0,
        settings={"network": asdict(SIZE)},
    )
    return save(folder, make_network(std, grid).state_dict(), card)
