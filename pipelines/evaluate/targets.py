"""Held-out targets: outcomes in states of the test split, half of them made with another item."""

import numpy as np

from common.domain.case import Case
from common.domain.errors import ModelError
from common.domain.model import PredictiveModel
from common.domain.scene import State
from common.storage.dataset import Dataset, Samples
from common.tasks.plating_sampler import sample_action, sample_item

ATTEMPTS = 20


def held_out_target(dataset: Dataset, samples: Samples, index: int, *, seed: int, simulator: PredictiveModel) -> Case:
    """Return target ``index``, from 0: one for each test state, the even ones made with the state's own item.

    A target made with the own item is the outcome in the data set, and its action the true one. For the others an
    item and an action are drawn from the seed and simulated, again until the outcome is at rest.

    Args:
        dataset: The data set.
        samples: Its test split.
        index: Number of the target.
        seed: Seed of items and actions.
        simulator: Makes the outcomes of other items.

    Raises:
        ModelError: No draw gave a target at rest.
    """
    groups, first = np.unique(samples.groups, return_index=True)
    state, sample = dataset.state("test", int(groups[index])), int(first[index])
    name = f"{dataset.card.name}-test-{int(groups[index]):05d}"
    if index % 2 == 0:
        x, y = samples.actions[sample].tolist()
        return Case(name, seed, state, samples.outcomes[sample], (x, y), True)
    reason = ""
    for attempt in range(ATTEMPTS):
        rng = np.random.default_rng([seed, index, attempt])
        maker = State(state.scene, sample_item(rng, state.grid))
        x, y = sample_action(rng, maker).tolist()
        try:
            outcome = simulator.predict(maker, np.array([[x, y]]))
        except ModelError as error:
            reason = str(error)
            continue
        if not outcome.warnings[0]:
            return Case(name, seed, state, outcome.heights[0], (x, y), False)
        reason = outcome.warnings[0]
    raise ModelError(f"{name}: expected a target at rest within {ATTEMPTS} draws, the last failed: {reason}")
