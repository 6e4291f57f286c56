"""Train the learned model on simulated placements, and measure it where it was not trained."""

from collections.abc import Callable
from dataclasses import asdict, dataclass, field
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from common.domain.deviation import deviation
from common.domain.grid import Grid
from common.domain.model import PredictiveModel
from common.learning.splits import folds, split
from common.learning.training import Epoch, History, TrainingSettings, seeded, train
from common.learning.weights import DatasetCard, GridCard, WeightsCard, save
from common.storage.dataset import Dataset, Samples
from pipelines.predictions import predict_samples, rmse
from pipelines.train.images import Images
from pipelines.train.windows import Windows
from services.heuristic import HeuristicModel
from services.learned.encoder_decoder import ARCHITECTURE as PAPER_ARCHITECTURE
from services.learned.encoder_decoder import EncoderDecoder, EncoderDecoderSettings, PaperLearnedModel
from services.learned.model import ARCHITECTURE, LearnedModel
from services.learned.network import NetworkSettings, ResidualNetwork

VERSION = "1"
DEVIATIONS = "deviations.npz"

Report = Callable[[int, Epoch], None]
"""Is told of every epoch: 0 for the released network, k for the one that did not see fold k."""


@dataclass(frozen=True)
class LearnedSettings:
    """How the learned model is made.

    Attributes:
        network: Its size, of our network or of the paper's.
        training: How it is trained; the seed also draws the split and the folds.
        validation_share: Share of the states that decide when to stop.
        folds: Networks for cross-fitting; each training sample is predicted by the one that did not see its state.
    """

    network: NetworkSettings | EncoderDecoderSettings = field(default_factory=NetworkSettings)
    training: TrainingSettings = field(
        default_factory=lambda: TrainingSettings(epochs=48, batch=16, learning_rate=4e-3, patience=48, bfloat16=True)
    )
    validation_share: float = 0.1
    folds: int = 2


@dataclass(frozen=True)
class CrossFit:
    """What copies of the model say about samples that they were not trained on.

    Attributes:
        fold: Which copy predicted each training sample, from 1 ``(N,)``.
        deviation_m: Its deviation from the outcome ``(N,)`` [m].
        rmse_m: The root mean squared difference ``(N,)`` [m].
    """

    fold: NDArray[np.int64]
    deviation_m: NDArray[np.float64]
    rmse_m: NDArray[np.float64]


PAPER = LearnedSettings(
    network=EncoderDecoderSettings(),
    training=TrainingSettings(epochs=60, batch=16, learning_rate=2e-3, patience=60, bfloat16=True),
)
"""How the paper's network is trained."""


def prepare(samples: Samples, grid: Grid, settings: LearnedSettings) -> Windows | Images:
    """Return samples as the network of these settings sees them."""
    if isinstance(settings.network, EncoderDecoderSettings):
        return Images.of(samples, grid)
    return Windows.of(samples, grid, size=settings.network.window)


def fit(
    windows: Windows | Images,
    indices: NDArray[np.integer],
    settings: LearnedSettings,
    *,
    report: Callable[[Epoch], None] = lambda epoch: None,
) -> tuple[ResidualNetwork | EncoderDecoder, History]:
    """Return a network trained on some samples ``(K,)``, a share of whose states decides when to stop."""
    seed = settings.training.seed
    training, validation = split(windows.groups[indices], share=settings.validation_share, seed=seed)
    with seeded(seed):
        if isinstance(settings.network, EncoderDecoderSettings):
            network = EncoderDecoder(settings.network, windows.grid)
        else:
            network = ResidualNetwork(settings.network, windows.grid)
    history = train(
        network,
        windows.loss,
        training=indices[training],
        validation=indices[validation],
        settings=settings.training,
        report=report,
    )
    return network, history


def cross_fit(
    dataset: Dataset, samples: Samples, windows: Windows | Images, settings: LearnedSettings, *, report: Report
) -> CrossFit:
    """Predict every training sample with a network that was trained on the states of the other folds."""
    fold = 1 + folds(samples.groups, count=settings.folds, seed=settings.training.seed)
    deviation_m, rmse_m = np.empty(len(samples)), np.empty(len(samples))
    for number in range(1, settings.folds + 1):
        network, _ = fit(windows, np.flatnonzero(fold != number), settings, report=_numbered(report, number))
        held_out = np.flatnonzero(fold == number)
        predicted = predict_samples(_model(network), dataset, "train", samples, held_out)
        deviation_m[held_out] = deviation(predicted, samples.outcomes[held_out])
        rmse_m[held_out] = rmse(predicted, samples.outcomes[held_out])
    return CrossFit(fold, deviation_m, rmse_m)


def release(
    dataset: Dataset, folder: Path, settings: LearnedSettings, *, report: Report = lambda number, epoch: None
) -> WeightsCard:
    """Train, measure and cross-fit the learned model, write all of it to a folder and return its card.

    Beside weights and card, ``deviations.npz`` holds what the model's MDE learns from: ``deviation_m`` ``(N,)`` of
    the training samples by cross-fitting, with ``fold`` and ``rmse_m``, and ``test_deviation_m`` ``(M,)`` of the
    released weights; all in the order of ``dataset.samples``, and ``actions`` and ``test_actions`` that tell them.
    """
    samples, grid = dataset.samples("train"), dataset.card.grid.grid()
    windows = prepare(samples, grid, settings)
    network, history = fit(windows, np.arange(len(samples)), settings, report=_numbered(report, 0))
    test = dataset.samples("test")
    everything = np.arange(len(test))
    learned = predict_samples(_model(network), dataset, "test", test, everything)
    heuristic = rmse(predict_samples(HeuristicModel(), dataset, "test", test, everything), test.outcomes)
    found = rmse(learned, test.outcomes)
    crossed = cross_fit(dataset, samples, windows, settings, report=report) if settings.folds else None
    card = WeightsCard(
        name=LearnedModel.name,
        version=VERSION,
        architecture=PAPER_ARCHITECTURE if isinstance(network, EncoderDecoder) else ARCHITECTURE,
        dataset=DatasetCard(
            name=dataset.card.name, seed=dataset.card.seed, version=dataset.card.version, samples=len(samples)
        ),
        grid=GridCard.of(grid),
        seed=settings.training.seed,
        settings=asdict(settings),
        metrics={
            "test_samples": len(test),
            "test_rmse_m": float(found.mean()),
            "test_rmse_std_m": float(found.std()),
            "heuristic_test_rmse_m": float(heuristic.mean()),
            "cross_fitted_rmse_m": None if crossed is None else float(crossed.rmse_m.mean()),
            "epochs": len(history.epochs),
            "best_epoch": history.best,
            "validation_loss": history.epochs[history.best - 1].validation,
            "training_loss": history.epochs[history.best - 1].training,
        },
    )
    folder.mkdir(parents=True, exist_ok=True)
    if crossed is not None:
        np.savez(
            folder / DEVIATIONS,
            version=VERSION,
            actions=samples.actions,
            test_actions=test.actions,
            test_deviation_m=deviation(learned, test.outcomes),
            **asdict(crossed),
        )
    return save(folder, network.state_dict(), card)


def _model(network: ResidualNetwork | EncoderDecoder) -> PredictiveModel:
    if isinstance(network, EncoderDecoder):
        return PaperLearnedModel(network, version=VERSION)
    return LearnedModel(network, version=VERSION)


def _numbered(report: Report, number: int) -> Callable[[Epoch], None]:
    return lambda epoch: report(number, epoch)
