"""Make the weights and the card of one MDE."""

import hashlib
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from common.learning.weights import DatasetCard, GridCard, WeightsCard, save
from common.storage.dataset import Dataset
from pipelines.mde.examples import Examples
from pipelines.mde.scores import acceptance, mean_absolute_error
from pipelines.mde.train import EnsembleSettings, Report, Trained, settings_card, train_ensemble
from services.mde.ensemble import facts
from services.mde.familiarity import Familiarity

VERSION = "1"
DEFAULT_D_MAX = 0.4
"""The paper's threshold."""

FEWEST_WITHIN, MOST_WITHIN = 0.4, 0.6
"""Shares of the samples that a declared threshold lets pass, if the default does not."""


def release(
    dataset: Dataset,
    model: str,
    deviation_m: NDArray[np.floating],
    folder: Path,
    settings: EnsembleSettings,
    *,
    model_version: str,
    scale_m: float,
    report: Report = lambda member, epoch: None,
) -> WeightsCard:
    """Train the MDE of a model, write it to a folder and return its card.

    Args:
        dataset: The data set; its training split is used.
        model: Name of the model.
        deviation_m: How far the model was from each outcome of the training split ``(N,)`` [m].
        folder: Where to write.
        settings: How to train.
        model_version: Version of the model whose deviations these are.
        scale_m: The deviation that counts as 1 [m].
        report: Told of every epoch of every member.
    """
    grid, examples = dataset.card.grid.grid(), Examples.of(dataset.samples("train"), deviation_m, scale_m)
    trained = train_ensemble(examples, grid, settings, report=report)
    samples, first = examples.samples, np.unique(examples.samples.groups, return_index=True)[1]
    covered = Familiarity.of(
        grid,
        samples.scene_heights[first],
        samples.scene_materials[first],
        samples.item_heights[first],
        samples.item_materials[first],
        actions=samples.actions,
    )
    d_max = declared_threshold(examples.deviations)
    metrics = {
        "model_version": model_version,
        "deviations_sha256": deviations_digest(deviation_m),
        "d_max": d_max,
        "deviation_mean": float(examples.deviations.mean()),
        "held_out": _metrics(examples, trained, d_max),
    }
    card = WeightsCard(
        name=f"mde_{model}",
        version=VERSION,
        architecture=settings.variant,
        dataset=DatasetCard(
            name=dataset.card.name, seed=dataset.card.seed, version=dataset.card.version, samples=len(samples)
        ),
        grid=GridCard.of(grid),
        seed=settings.training.seed,
        deviation_scale_m=scale_m,
        settings=settings_card(settings),
        metrics=metrics,
        statistics=covered.statistics(),
    )
    trained.ensemble.facts.copy_(facts(card, factor=trained.factor))
    return save(folder, trained.ensemble.state_dict(), card)


def deviations_digest(deviation_m: NDArray[np.floating]) -> str:
    """Return the SHA-256 in hex of deviations in metres, as float64 in little-endian bytes."""
    return hashlib.sha256(np.ascontiguousarray(deviation_m, "<f8").tobytes()).hexdigest()


def declared_threshold(deviations: NDArray[np.floating]) -> float:
    """Return 0.4 if 40 to 60% of the deviations are below it, else the multiple of 0.05 nearest to their median."""
    if FEWEST_WITHIN <= float((deviations < DEFAULT_D_MAX).mean()) <= MOST_WITHIN:
        return DEFAULT_D_MAX
    return float(np.clip(round(20 * float(np.median(deviations))) / 20, 0.05, 1.0))


def _metrics(examples: Examples, trained: Trained, d_max: float) -> dict[str, Any]:
    """Return figures of the samples that no member was trained on."""
    truth, median = examples.deviations[trained.calibration], trained.held_out.median.clip(0, 1)
    return {
        "samples": len(truth),
        "mae": mean_absolute_error(truth, median),
        "median_baseline_mae": mean_absolute_error(truth, np.full_like(truth, np.median(examples.deviations))),
        **asdict(acceptance(truth, median, d_max=d_max)),
    }
