"""Laws that the networks of all variants obey."""

import numpy as np
import pytest
import torch
from torch import Tensor

from common.domain.errors import RequestError
from common.domain.grid import Grid
from common.learning.training import seeded
from services.mde.network import DeviationNetwork, inputs
from services.mde.network_crop import CropNetwork
from services.mde.variants import VARIANTS
from tests.mde_fakes import GRID, SMALL

ACTIONS = np.array([[0.012, -0.031], [-0.05, 0.02], [0.0, 0.0], [0.041, 0.037]])


@pytest.fixture(params=VARIANTS)
def network(request: pytest.FixtureRequest) -> DeviationNetwork:
    return make(request.param)


def make(variant: str, seed: int = 0) -> DeviationNetwork:
    with seeded(seed):
        return VARIANTS[variant](GRID, **SMALL[variant]).eval()


def arrays(states: int, seed: int = 0) -> tuple[np.ndarray, np.ndarray]:
    """Return random heights and materials of some states, alike far from the centre."""
    rng = np.random.default_rng(seed)
    near = np.hypot(GRID.x[None, :], GRID.y[:, None]) < 0.05
    heights = np.where(near, rng.uniform(0, 0.03, (states, *GRID.shape)), 0.0)
    there = near & (rng.random((states, *GRID.shape)) < 0.5)
    material = np.array([1000.0, 1e5, 0.4])[None, :, None, None]
    return heights, np.where(there[:, None], material, 0.0)


def encoded(network: DeviationNetwork, states: int) -> tuple[Tensor, ...]:
    scene, item = (inputs(*arrays(states, seed), network.pooling) for seed in (1, 2))
    return network.encode(scene, item)


@torch.inference_mode()
def test_a_network_gives_a_median_and_a_bound_above_it_for_every_action(network: DeviationNetwork):
    median, gap = network.estimate(network.describe(encoded(network, 1), ACTIONS))
    assert median.shape == gap.shape == (4,)
    assert torch.isfinite(median).all()
    assert (gap > 0).all()


@torch.inference_mode()
def test_one_state_for_all_actions_is_the_same_as_one_state_each(network: DeviationNetwork):
    (one,) = {len(part) for part in encoded(network, 1)}
    assert one == 1
    together = network.describe(encoded(network, 1), ACTIONS)
    each = tuple(part.expand(4, *part.shape[1:]) for part in encoded(network, 1))
    torch.testing.assert_close(network.describe(each, ACTIONS), together)


@torch.inference_mode()
def test_states_are_encoded_independently(network: DeviationNetwork):
    both = encoded(network, 2)
    scenes, items = arrays(2, 1), arrays(2, 2)
    alone = network.encode(*(inputs(a[1:], b[1:], network.pooling) for a, b in (scenes, items)))
    for part, single in zip(both, alone, strict=True):
        torch.testing.assert_close(part[1:], single)


@torch.inference_mode()
def test_item_scene_and_action_all_matter(network: DeviationNetwork):
    base = network.describe(encoded(network, 1), ACTIONS[:1])
    scene, item = (inputs(*arrays(1, seed), network.pooling) for seed in (1, 2))
    for other in (network.encode(item, item), network.encode(scene, scene)):
        assert not torch.allclose(network.describe(other, ACTIONS[:1]), base, atol=1e-4)
    assert not torch.allclose(network.describe(network.encode(scene, item), ACTIONS[3:]), base, atol=1e-4)


@torch.inference_mode()
def test_an_estimate_is_continuous_in_the_action(network: DeviationNetwork):
    steps = np.linspace(0, 0.012, 121)[:, None] * np.array([1.0, 0.5])
    median, _ = network.estimate(network.describe(encoded(network, 1), steps))
    jumps, whole = median.diff().abs().max(), median.max() - median.min()
    assert jumps < 0.1 * whole


@torch.inference_mode()
def test_the_crop_sees_only_where_the_action_is_relative_to_the_scene():
    with seeded(0):
        network = CropNetwork(GRID, size=8).eval()
    heights, materials = arrays(1)
    item = inputs(*arrays(1, 2), 2)
    move = 4  # cells, one of the feature map's
    moved = tuple(np.roll(part, (move, 2 * move), axis=(-2, -1)) for part in (heights, materials))
    step = GRID.cell * move * np.array([2.0, 1.0])
    actions = np.array([[-0.01, 0.005], [0.002, -0.008]])
    first = network.describe(network.encode(inputs(heights, materials, 2), item), actions)
    second = network.describe(network.encode(inputs(*moved, 2), item), actions + step)
    torch.testing.assert_close(first, second, rtol=0.02, atol=2e-3)


def test_a_grid_that_the_windows_do_not_fit_is_refused():
    for grid in (Grid(66, 64, 0.0045), Grid(60, 60, 0.0045)):
        with pytest.raises(RequestError, match="expected a grid of multiples of 4 cells, 64 at least"):
            CropNetwork(grid)
