"""Whose MDE is trained or measured: a model with its deviations on a data set."""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from common.domain.model import PredictiveModel
from common.storage.dataset import Dataset
from pipelines.mde.examples import model_deviations


@dataclass(frozen=True)
class Subject:
    """A model and how far it was from the simulator.

    Attributes:
        name: Its name.
        version: Its version.
        train_m: Deviations that its MDEs learn from ``(N,)`` [m].
        test_m: Its deviations on the test samples ``(M,)`` [m].
    """

    name: str
    version: str
    train_m: NDArray[np.float64]
    test_m: NDArray[np.float64]

    @classmethod
    def predicting(
        cls, dataset: Dataset, model: PredictiveModel, *, report: Callable[[int], None] = lambda done: None
    ) -> "Subject":
        """Return a model that was not trained on the data set, with its deviations on both splits."""
        train_m = model_deviations(dataset, "train", model, report=report)
        test_m = model_deviations(dataset, "test", model, report=lambda done: report(len(train_m) + done))
        return cls(model.name, model.version, train_m, test_m)
