"""What a model says about the samples of a data set."""

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from common.domain.model import PredictiveModel
from common.storage.dataset import Dataset, Samples
from common.storage.dataset_card import Split

Done = Callable[[int], None]
"""Is told how many samples are done."""


def predict_samples(
    model: PredictiveModel,
    dataset: Dataset,
    split: Split,
    samples: Samples,
    indices: NDArray[np.integer],
    *,
    report: Done = lambda done: None,
) -> NDArray[np.float32]:
    """Return the model's heightmaps of some samples ``(K, H, W)`` [m], in the order of ``indices`` ``(K,)``.

    The model gets the states exactly as they were simulated, and all actions of a state that are wanted at once.
    """
    predicted = np.empty((len(indices), *samples.outcomes.shape[1:]), dtype=np.float32)
    groups, done = samples.groups[indices], 0
    for group in np.unique(groups):
        (places,) = np.nonzero(groups == group)
        state = dataset.state(split, int(group))
        for start in range(0, len(places), model.largest_batch):
            part = places[start : start + model.largest_batch]
            predicted[part] = model.predict(state, samples.actions[indices[part]]).heights
        done += len(places)
        report(done)
    return predicted


def rmse(predicted: NDArray[np.floating], outcomes: NDArray[np.floating]) -> NDArray[np.float64]:
    """Return each sample's root mean squared height difference over the grid ``(K,)`` [m], as in Table I."""
    difference = predicted.astype(np.float64) - outcomes
    return np.sqrt((difference**2).mean(axis=(-2, -1)))
