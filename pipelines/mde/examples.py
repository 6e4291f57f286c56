"""What MDEs learn from: states and actions of a data set, and how far a model was from the simulator there."""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from common.domain.deviation import deviation
from common.domain.errors import RequestError
from common.domain.model import PredictiveModel
from common.storage.dataset import Dataset, Samples
from common.storage.dataset_card import Split
from pipelines.predictions import predict_samples
from services.heuristic import HeuristicModel

SCALE_PERCENTILE = 99.0
"""The deviation that counts as 1 is this percentile of the heuristic's on the training samples."""


@dataclass(frozen=True)
class Examples:
    """Samples of one split with the deviations of one model.

    Attributes:
        samples: States, actions and outcomes.
        deviations: How far the model was from the outcome, scaled and clipped to [0, 1] ``(N,)``.
        scale_m: The deviation that counts as 1 [m].
    """

    samples: Samples
    deviations: NDArray[np.float32]
    scale_m: float

    @classmethod
    def of(cls, samples: Samples, deviation_m: NDArray[np.floating], scale_m: float) -> "Examples":
        """Return samples with deviations in metres ``(N,)``, scaled."""
        if deviation_m.shape != (len(samples),) or not np.isfinite(deviation_m).all():
            raise RequestError(f"deviations: expected {len(samples)} finite numbers, got {deviation_m.shape}")
        return cls(samples, np.clip(deviation_m / scale_m, 0, 1).astype(np.float32), scale_m)


def deviation_scale(dataset: Dataset) -> float:
    """Return the deviation that counts as 1 [m]: what the data set's card says, else as `SCALE_PERCENTILE` says.

    It follows from the data set alone, and is rounded to a micrometre.
    """
    if dataset.card.deviation_scale_m is not None:
        return dataset.card.deviation_scale_m
    found = model_deviations(dataset, "train", HeuristicModel())
    return round(float(np.percentile(found, SCALE_PERCENTILE)), 6)


def model_deviations(
    dataset: Dataset, split: Split, model: PredictiveModel, *, report: Callable[[int], None] = lambda done: None
) -> NDArray[np.float64]:
    """Return ``d(f(s_0, a), s_T)`` of a model on all samples of a split ``(N,)`` [m].

    Args:
        dataset: The data set.
        split: ``train`` or ``test``.
        model: Any model; it gets the states exactly as they were simulated.
        report: Called with the number of samples that are done.
    """
    samples = dataset.samples(split)
    predicted = predict_samples(model, dataset, split, samples, np.arange(len(samples)), report=report)
    return deviation(predicted, samples.outcomes)
