"""What frozen networks make of states and actions: descriptions, of which the last layers are linear functions."""

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from common.domain.scene import State
from common.learning.features import SYMMETRIES, transform, transform_actions
from common.storage.dataset import Samples
from services.mde.ensemble import Ensemble
from services.mde.network import inputs

CHUNK = 64
"""Samples that are computed together."""


@torch.no_grad()
def describe_samples(ensemble: Ensemble, samples: Samples, *, turned: bool = False) -> Tensor:
    """Return each member's descriptions of samples ``(K, S, N, F)``.

    Args:
        ensemble: The networks, in evaluation mode.
        samples: N samples, on the grid of the networks.
        turned: Whether every sample is seen in all of the plate's symmetries, the first of which is as it is; one
            symmetry (S = 1) for networks that were trained without.
    """
    networks = ensemble.networks
    symmetries = range(SYMMETRIES if turned and networks[0].symmetric else 1)
    scene = inputs(samples.scene_heights, samples.scene_materials, networks[0].pooling)
    item = inputs(samples.item_heights, samples.item_materials, networks[0].pooling)
    found = torch.empty(len(networks), len(symmetries), len(samples), networks[0].last.in_features)
    for symmetry in symmetries:
        actions = transform_actions(samples.actions, symmetry)
        for chunk in torch.arange(len(samples)).split(CHUNK):
            seen = transform(scene[chunk], symmetry), transform(item[chunk], symmetry)
            for index, member in enumerate(networks):
                found[index, symmetry, chunk] = member.describe(member.encode(*seen), actions[chunk.numpy()])
    return found


@torch.no_grad()
def describe_actions(ensemble: Ensemble, state: State, actions: NDArray[np.float64]) -> Tensor:
    """Return each member's descriptions ``(K, B, F)`` of actions ``(B, 2)`` [m] in one state."""
    pooling = ensemble.networks[0].pooling
    scene = inputs(state.scene.heights[None], state.scene.materials[None], pooling)
    item = inputs(state.item.heights[None], state.item.materials[None], pooling)
    parts = [
        torch.cat(
            [member.describe(encoding, actions[start : start + CHUNK]) for start in range(0, len(actions), CHUNK)]
        )
        for member, encoding in zip(ensemble.networks, ensemble.encode(scene, item), strict=True)
    ]
    return torch.stack(parts)
