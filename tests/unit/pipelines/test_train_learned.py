"""Training of the learned model on a small data set in which items sink into fries."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch

from common.domain.deviation import deviation
from common.learning.features import SYMMETRIES
from common.learning.training import Epoch, TrainingSettings
from common.learning.weights import TENSORS, read_card
from common.storage.dataset import Dataset
from pipelines.mde.crossfit import read_deviations
from pipelines.predictions import predict_samples, rmse
from pipelines.train.learned import DEVIATIONS, LearnedSettings, cross_fit, fit, release
from pipelines.train.windows import Windows
from services.heuristic import HeuristicModel
from services.learned.model import LearnedModel
from services.learned.network import NetworkSettings, ResidualNetwork
from tests.mde_fakes import write_dataset

SIZE = NetworkSettings(window=48, widths=(16, 16, 16), blocks=1)
TRAINING = TrainingSettings(epochs=12, batch=4, learning_rate=5e-3, threads=1)
SETTINGS = LearnedSettings(network=SIZE, training=TRAINING, validation_share=0.2, folds=2)


@pytest.fixture(scope="module")
def dataset(tmp_path_factory: pytest.TempPathFactory) -> Dataset:
    return write_dataset(tmp_path_factory.mktemp("data") / "small")


@pytest.fixture(scope="module")
def windows(dataset: Dataset) -> Windows:
    return Windows.of(dataset.samples("train"), dataset.card.grid.grid(), size=48)


@pytest.fixture(scope="module")
def released(dataset: Dataset, tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("models") / "learned"
    release(dataset, folder, SETTINGS)
    return folder


def test_it_learns_what_the_heuristic_gets_wrong_and_the_card_says_how_well(dataset: Dataset, released: Path):
    card, samples = read_card(released), dataset.samples("test")
    predicted = predict_samples(LearnedModel.load(released), dataset, "test", samples, np.arange(len(samples)))
    found = rmse(predicted, samples.outcomes)
    assert card.metrics["test_rmse_m"] == pytest.approx(found.mean())
    assert card.metrics["test_rmse_std_m"] == pytest.approx(found.std())
    assert found.mean() < 0.6 * card.metrics["heuristic_test_rmse_m"]
    assert (card.dataset.name, card.dataset.samples) == ("small", 32)
    assert card.grid.grid() == dataset.card.grid.grid()


def test_the_mde_finds_cross_fitted_and_test_deviations_beside_the_weights(dataset: Dataset, released: Path):
    found, samples = read_deviations(released / DEVIATIONS, dataset), dataset.samples("test")
    predicted = predict_samples(LearnedModel.load(released), dataset, "test", samples, np.arange(len(samples)))
    np.testing.assert_allclose(found.test_m, deviation(predicted, samples.outcomes))
    assert found.version == read_card(released).version


def test_each_training_sample_is_judged_by_a_network_that_never_saw_its_state(dataset: Dataset, windows: Windows):
    samples = dataset.samples("train")
    short = replace(SETTINGS, training=replace(TRAINING, epochs=2))
    crossed = cross_fit(dataset, samples, windows, short, report=lambda number, epoch: None)
    assert set(crossed.fold) == {1, 2}
    for group in np.unique(samples.groups):
        assert len(set(crossed.fold[samples.groups == group])) == 1
    for number in (1, 2):
        network, _ = fit(windows, np.flatnonzero(crossed.fold != number), short)
        own = np.flatnonzero(crossed.fold == number)
        predicted = predict_samples(LearnedModel(network, version="1"), dataset, "train", samples, own)
        np.testing.assert_array_equal(crossed.deviation_m[own], deviation(predicted, samples.outcomes[own]))
        np.testing.assert_array_equal(crossed.rmse_m[own], rmse(predicted, samples.outcomes[own]))


def test_the_same_seed_gives_the_same_bytes_and_another_seed_others(dataset: Dataset, tmp_path: Path):
    short = replace(SETTINGS, training=replace(TRAINING, epochs=1), folds=0)
    other = replace(short, training=replace(short.training, seed=1))
    for name, settings in (("a", short), ("b", short), ("c", other)):
        release(dataset, tmp_path / name, settings)
    first, second, third = ((tmp_path / name / TENSORS).read_bytes() for name in "abc")
    assert first == second
    assert first != third
    assert not (tmp_path / "a" / DEVIATIONS).exists()


def test_every_epoch_is_told_of(dataset: Dataset, tmp_path: Path):
    told: list[tuple[int, Epoch]] = []
    short = replace(SETTINGS, training=replace(TRAINING, epochs=2))
    release(dataset, tmp_path, short, report=lambda number, epoch: told.append((number, epoch)))
    assert [(number, epoch.number) for number, epoch in told] == [(0, 1), (0, 2), (1, 1), (1, 2), (2, 1), (2, 2)]


def test_the_networks_task_is_the_outcome_less_the_heuristic_sum(dataset: Dataset, windows: Windows):
    samples = dataset.samples("train")
    sums = predict_samples(HeuristicModel(), dataset, "train", samples, np.arange(len(samples)))
    expected = 1e4 * ((samples.outcomes - sums).astype(np.float64) ** 2).sum(axis=(1, 2))
    np.testing.assert_allclose((windows.residuals.double() ** 2).sum(dim=(1, 2)).numpy(), expected, rtol=2e-2)


def test_augmentation_turns_what_is_seen_and_what_is_asked_for_alike(windows: Windows):
    class Lifting(torch.nn.Module):
        """Answers the scene's height: no symmetry can change how well that fits its own, turned residual."""

        def forward(self, inputs: torch.Tensor) -> torch.Tensor:
            return inputs[:, 0]

    indices, generator = torch.arange(8), torch.Generator().manual_seed(0)
    plain = windows.loss(Lifting(), indices, None)
    for _ in range(SYMMETRIES):
        assert windows.loss(Lifting(), indices, generator).item() == pytest.approx(plain.item(), rel=1e-5)


def test_an_untrained_network_has_the_heuristics_error(windows: Windows):
    network = ResidualNetwork(SIZE, windows.grid)
    expected = ((windows.residuals**2).mean(dim=(1, 2)) + 0.02**2).sqrt().mean().item()
    assert windows.loss(network, torch.arange(len(windows.residuals)), None).item() == pytest.approx(expected, rel=1e-5)
