"""The training loop on a least-squares problem with a known answer."""

import numpy as np
import pytest
import torch
from torch import Generator, Tensor, nn

from common.learning.training import Epoch, TrainingSettings, seeded, train

INPUTS = torch.from_numpy(np.random.default_rng(0).normal(size=(120, 3)).astype(np.float32))
TARGETS = INPUTS @ torch.tensor([1.0, -2.0, 0.5]) + 0.25
SETTINGS = TrainingSettings(epochs=60, batch=16, learning_rate=0.05, weight_decay=0.0, average=0.9, threads=1)
TRAINING, VALIDATION = np.arange(100), np.arange(100, 120)


def squared_error(network: nn.Module, indices: Tensor, generator: Generator | None) -> Tensor:
    noise = 0.0 if generator is None else 0.01 * torch.randn(len(indices), generator=generator)
    return ((network(INPUTS[indices])[:, 0] + noise - TARGETS[indices]) ** 2).mean()


def trained(settings: TrainingSettings, **options: object) -> nn.Module:
    with seeded(settings.seed):
        network = nn.Linear(3, 1)
    options.setdefault("loss", squared_error)
    train(network, training=TRAINING, validation=VALIDATION, settings=settings, **options)  # type: ignore[arg-type]
    return network


def test_it_finds_the_least_squares_solution():
    network = trained(SETTINGS)
    np.testing.assert_allclose(network.weight.detach().numpy(), [[1, -2, 0.5]], atol=5e-3)
    np.testing.assert_allclose(network.bias.detach().numpy(), [0.25], atol=5e-3)


def test_the_same_seed_gives_the_same_bits_and_another_seed_others():
    first, second, other = (trained(TrainingSettings(epochs=5, seed=seed)).weight for seed in (1, 1, 2))
    assert torch.equal(first, second)
    assert not torch.equal(first, other)


def test_the_global_generator_is_left_alone():
    torch.manual_seed(5)
    expected = torch.rand(3)
    torch.manual_seed(5)
    trained(TrainingSettings(epochs=2))
    assert torch.equal(torch.rand(3), expected)


def test_it_stops_early_and_keeps_the_best_weights():
    values = iter([5.0, 3.0, 4.0, 4.0, 4.0, 4.0])
    kept: list[Tensor] = []

    def loss(network: nn.Module, indices: Tensor, generator: Generator | None) -> Tensor:
        if generator is not None:
            return squared_error(network, indices, generator)
        kept.append(network.weight.detach().clone())  # type: ignore[operator, union-attr]
        return torch.tensor(next(values))

    seen: list[Epoch] = []
    with seeded(0):
        network = nn.Linear(3, 1)
    settings = TrainingSettings(epochs=50, batch=32, patience=3)
    history = train(network, loss, training=TRAINING, validation=VALIDATION, settings=settings, report=seen.append)
    assert (history.best, len(history.epochs)) == (2, 5)
    assert list(history.epochs) == seen
    assert torch.equal(network.weight, kept[1])


def test_a_loss_that_is_not_finite_and_an_empty_part_are_refused():
    with pytest.raises(ValueError, match="finite loss"):
        trained(SETTINGS, loss=lambda network, indices, generator: network(INPUTS[indices]).sum() * torch.nan)
    with pytest.raises(ValueError, match="100 and 0"):
        train(nn.Linear(3, 1), squared_error, training=TRAINING, validation=np.arange(0), settings=SETTINGS)
