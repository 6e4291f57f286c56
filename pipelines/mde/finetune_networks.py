"""Train whole networks on trials: all weights of the base, or new ones, which the paper compares with."""

import copy
import math
from dataclasses import replace

import numpy as np
import torch
from numpy.typing import NDArray

from common.learning.splits import folds
from common.learning.training import TrainingSettings, seeded, train
from pipelines.mde.descriptions import describe_samples
from pipelines.mde.examples import Examples
from pipelines.mde.finetuned import Finetuned, limits_for
from pipelines.mde.train import TRAINING, Tensors
from services.mde.distance import whitening
from services.mde.ensemble import Calibrated, Ensemble, build

ANEW = replace(TRAINING, batch=16)
ONWARD = replace(ANEW, learning_rate=1e-4, weight_decay=0.0)
"""How new networks are trained, and trained ones on."""

LEFT_OUT = 5
"""A single member leaves out one trial in so many."""


def finetune_full(base: Calibrated, examples: Examples, *, iterations: int, seed: int) -> Finetuned:
    """Train all weights of every member on.

    Means and whitenings of the descriptions stay those of the base: at this learning rate the descriptions move little
    against their spread. Arguments as of `finetune_last`.
    """
    tuned = copy.deepcopy(base.ensemble).requires_grad_(True)
    part = _train(tuned, examples, ONWARD, iterations=iterations, seed=seed)
    return _judged(tuned, base, examples, part, least=base.ensemble.limits)


def train_scratch(base: Calibrated, examples: Examples, *, iterations: int, seed: int) -> Finetuned:
    """Train new networks of the base's architecture on the trials alone; arguments as of `finetune_last`."""
    with seeded(seed):
        new = build(base.card)
    part = _train(new, examples, ANEW, iterations=iterations, seed=seed)
    descriptions = describe_samples(new, examples.samples, turned=True)
    for index in range(len(new.networks)):
        seen = descriptions[index][:, part != index % (part.max() + 1)]
        new.means[index], new.whitenings[index] = whitening(seen.flatten(0, 1))
    return _judged(new, base, examples, part, least=None)


def _train(
    ensemble: Ensemble, examples: Examples, settings: TrainingSettings, *, iterations: int, seed: int
) -> NDArray[np.int64]:
    """Train each member without one part of the trials and return the part of each ``(N,)``.

    Nothing stops early, so that the part left out judges the member unseen.
    """
    members, groups = ensemble.networks, examples.samples.groups
    wanted = len(members) if len(members) > 1 else LEFT_OUT
    part = folds(groups, count=min(wanted, len(np.unique(groups))), seed=seed)
    data = Tensors.of(examples, members[0].pooling)
    for index, member in enumerate(members):
        seen = np.flatnonzero(part != index % (part.max() + 1))
        epochs = math.ceil(iterations / math.ceil(len(seen) / settings.batch))
        own = replace(settings, seed=seed * len(members) + index, epochs=epochs)
        with seeded(own.seed):  # dropout draws from the global generator
            train(member, data.loss, training=seen, validation=None, settings=own)
    ensemble.eval().requires_grad_(False)
    return part


def _judged(
    ensemble: Ensemble, base: Calibrated, examples: Examples, part: NDArray[np.int64], *, least: torch.Tensor | None
) -> Finetuned:
    """Return the ensemble with its limits and what each member says about the part that it did not see."""
    descriptions = describe_samples(ensemble, examples.samples, turned=True)
    ensemble.limits.copy_(
        limits_for(ensemble, descriptions, familiar=float(base.card.settings["familiar"]), least=least)
    )
    unseen = np.stack([part == index % (part.max() + 1) for index in range(len(ensemble.networks))])
    estimates = [member.estimate(descriptions[index, 0]) for index, member in enumerate(ensemble.networks)]
    median, gap = (torch.stack(values).double().numpy() for values in zip(*estimates, strict=True))
    judged = np.flatnonzero(unseen.any(axis=0))
    weights = unseen[:, judged] / unseen[:, judged].sum(axis=0)
    return Finetuned(
        ensemble,
        judged,
        (weights * median[:, judged]).sum(axis=0),
        (weights * gap[:, judged]).sum(axis=0),
        {"parts": int(part.max()) + 1},
    )
