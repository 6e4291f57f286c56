"""Fine-tune last layers, the paper's method, or no more than a shift and a scale of the estimates."""

import copy
import math

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from common.learning.splits import folds
from pipelines.mde.descriptions import describe_samples
from pipelines.mde.examples import Examples
from pipelines.mde.finetune_layers import Basis, Changes, Layers, train_layers
from pipelines.mde.finetuned import Finetuned, limits_for
from services.mde.ensemble import Calibrated, Ensemble
from services.mde.network import NARROWEST

FOLDS = 8
"""Parts of the trials in cross-validation, or as many as there are states."""

STRENGTHS, STRENGTHS_OF_FEW = (10.0, 30.0, 100.0), (100.0,)
"""Penalties to choose from; with fewer than `MANY` trials the choice costs more than it brings, and one is taken."""

MANY = 40
FRESH_GAP = 0.05
"""Distance to the raw upper bound of a layer that knows nothing."""


def finetune_last(
    base: Calibrated, examples: Examples, *, iterations: int, seed: int, scaled_only: bool = False, anew: bool = False
) -> Finetuned:
    """Train the last layer of every member towards the trials, all other weights stay.

    Cross-validation on the trials chooses the strength of the pull towards the first layer, and whether anything is
    learned at all, see `choose`; then every member is trained on all trials.

    Args:
        base: What to begin with.
        examples: The trials.
        iterations: Steps of the training.
        seed: Seed of the parts.
        scaled_only: Whether a layer may only shift and scale what it says.
        anew: Whether layers that begin with 0 are tried too: the base is the MDE of another model.
    """
    ensemble = base.ensemble
    descriptions = describe_samples(ensemble, examples.samples, turned=True)
    part = _parts(examples.samples.groups, seed=seed)
    sets = np.stack([np.ones(len(part), dtype=bool), *(part != fold for fold in range(part.max() + 1))])
    strengths = STRENGTHS if len(part) >= MANY else STRENGTHS_OF_FEW
    deviations = torch.from_numpy(examples.deviations)
    options: list[tuple[Layers, Tensor, dict[str, object]]] = []
    errors: list[NDArray[np.float64]] = []
    for name, start in _starts(ensemble, anew=anew).items():
        basis = _scales(start, descriptions) if scaled_only else Basis(ensemble.means, ensemble.whitenings)
        features, outputs = basis.features(descriptions), start.outputs(descriptions)
        changes = train_layers(
            features,
            outputs,
            deviations,
            sets=torch.from_numpy(sets),
            strengths=strengths,
            iterations=iterations,
            bounded=ensemble.networks[0].bounded,
        )
        held_out = outputs[:, 0, None] + _unseen(changes, features[:, 0], part)  # (K, L, N, 2)
        found = [(None, start, outputs[:, 0])] + [
            (strength, changes.applied(start, basis, chosen=0, strength=place), held_out[:, place])
            for place, strength in enumerate(strengths)
        ]
        for strength, layers, estimates in found:
            options.append((layers, estimates, {"start": name, "strength": strength}))
            errors.append((estimates[..., 0].mean(dim=0).clamp(0, 1) - deviations).abs().double().numpy())
    trained = np.array([chosen["strength"] is not None for _, _, chosen in options])
    layers, estimates, chosen = options[choose(np.stack(errors), trained)]
    tuned = _with_layers(ensemble, layers)
    tuned.limits.copy_(
        limits_for(tuned, descriptions, familiar=float(base.card.settings["familiar"]), least=ensemble.limits)
    )
    median, gap = _estimates(tuned, estimates)
    return Finetuned(tuned, np.arange(len(part)), median, gap, {**chosen, "folds": int(part.max()) + 1})


def choose(errors: NDArray[np.float64], trained: NDArray[np.bool_]) -> int:
    """Return the option with the smallest mean error, one that learns nothing only if it is clearly better.

    Without learning nothing is held out, so that few trials often speak for it by chance; clearly is by more than the
    standard error of the paired difference to the best option that learns.

    Args:
        errors: Of O options on N trials that they did not learn from ``(O, N)``.
        trained: Which options learn ``(O,)``, one or more of either.
    """
    means = errors.mean(axis=1)
    learns, stays = (int(np.where(which, means, np.inf).argmin()) for which in (trained, ~trained))
    worse = errors[learns] - errors[stays]
    return stays if worse.mean() > worse.std(ddof=1) / math.sqrt(len(worse)) else learns


def _parts(groups: NDArray[np.integer], *, seed: int) -> NDArray[np.int64]:
    return folds(groups, count=min(FOLDS, len(np.unique(groups))), seed=seed)


def _starts(ensemble: Ensemble, *, anew: bool) -> dict[str, Layers]:
    """Return the layers that training may begin with."""
    lasts = [member.last for member in ensemble.networks]
    own = Layers(
        torch.stack([last.weight.detach() for last in lasts]), torch.stack([last.bias.detach() for last in lasts])
    )
    if not anew:
        return {"base": own}
    fresh = torch.tensor([0.0, math.log(math.expm1(FRESH_GAP - NARROWEST))])
    return {"base": own, "fresh": Layers(torch.zeros_like(own.weight), fresh.expand_as(own.bias).clone())}


def _scales(start: Layers, descriptions: Tensor) -> Basis:
    """Return the basis whose only feature is the estimated median, with mean 0 and spread 1 over the trials."""
    row = start.weight[:, :1]
    spread = torch.einsum("ksnf,kjf->ksnj", descriptions, row).flatten(1).std(dim=1, correction=0)
    mean = descriptions.flatten(1, 2).mean(dim=1)
    return Basis(mean, row / spread.clamp_min(1e-6)[:, None, None])


def _unseen(changes: Changes, features: Tensor, part: NDArray[np.int64]) -> Tensor:
    """Return what is added for each trial by layers that did not see its part ``(K, L, N, 2)``."""
    added = changes.outputs(features)
    return torch.stack([added[:, 1 + fold, :, trial] for trial, fold in enumerate(part.tolist())], dim=2)


def _with_layers(ensemble: Ensemble, layers: Layers) -> Ensemble:
    tuned = copy.deepcopy(ensemble)
    for member, weight, bias in zip(tuned.networks, layers.weight, layers.bias, strict=True):
        member.last.weight.data.copy_(weight)
        member.last.bias.data.copy_(bias)
    return tuned


def _estimates(ensemble: Ensemble, outputs: Tensor) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return mean median and gap ``(N,)`` from the members' median and raw gap ``(K, N, 2)``."""
    median, gap = ensemble.networks[0].read(outputs)
    return median.mean(dim=0).double().numpy(), gap.mean(dim=0).double().numpy()
