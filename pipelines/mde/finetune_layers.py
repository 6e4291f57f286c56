"""Train last layers alone: features are frozen, so all members, folds and strengths are trained at once.

With white features ``z = A (x - mean)`` of a description x, a layer is ``W_0 x + b_0 + V z + c``. Adam minimises the
mean of ``|d - m|`` and of the pinball loss of the raw upper bound, as in the training of the base, plus
``|V|^2 strength / n``: ``|V|`` is the spread of the change over the data of the base.
"""

import math
from dataclasses import dataclass

import torch
from torch import Tensor
from torch.nn import functional

from services.mde.network import NARROWEST

LEARNING_RATE = 0.01
"""Adam's first learning rate; it falls to 0 along a cosine."""

GAP_UNIT = 0.05
"""A change of a gap's logarithm by 1 costs as much as a change of a median by this."""

SHIFT_STRENGTH = 0.2
"""Strength of the penalty of the shift c: it stands against few trials only."""

QUANTILE = 0.9
"""The raw upper bound's, as in the training of the base."""


@dataclass(frozen=True)
class Basis:
    """What may be added to the last layers: ``V matrix (x - mean)``.

    Attributes:
        mean: Of each member's descriptions ``(K, F)``.
        matrix: ``(K, P, F)``.
    """

    mean: Tensor
    matrix: Tensor

    def features(self, descriptions: Tensor) -> Tensor:
        """Return z ``(K, S, N, P)`` of descriptions ``(K, S, N, F)``."""
        return torch.einsum("ksnf,kpf->ksnp", descriptions - self.mean[:, None, None], self.matrix)


@dataclass(frozen=True)
class Layers:
    """Last layers of K members: the rows of a weight are median and gap.

    Attributes:
        weight: ``(K, ..., 2, F)``.
        bias: ``(K, ..., 2)``.
    """

    weight: Tensor
    bias: Tensor

    def outputs(self, descriptions: Tensor) -> Tensor:
        """Return median and raw gap ``(K, S, N, 2)`` of descriptions ``(K, S, N, F)``, for weights ``(K, 2, F)``."""
        return torch.einsum("ksnf,kjf->ksnj", descriptions, self.weight) + self.bias[:, None, None]


@dataclass(frozen=True)
class Changes:
    """What training adds to last layers, for each of C sets of trials and L strengths.

    Attributes:
        slopes: V ``(K, C, L, 2, P)``.
        shifts: c ``(K, C, L, 2)``.
    """

    slopes: Tensor
    shifts: Tensor

    def outputs(self, features: Tensor) -> Tensor:
        """Return what is added to median and raw gap ``(K, C, L, N, 2)`` at features ``(K, N, P)``."""
        return torch.einsum("knp,kcljp->kclnj", features, self.slopes) + self.shifts[..., None, :]

    def applied(self, start: Layers, basis: Basis, *, chosen: int, strength: int) -> Layers:
        """Return the last layers that come of one set and strength."""
        slopes = torch.einsum("kjp,kpf->kjf", self.slopes[:, chosen, strength], basis.matrix)
        shifts = self.shifts[:, chosen, strength] - torch.einsum("kjf,kf->kj", slopes, basis.mean)
        return Layers(start.weight + slopes, start.bias + shifts)


def train_layers(
    features: Tensor,
    outputs: Tensor,
    deviations: Tensor,
    *,
    sets: Tensor,
    strengths: tuple[float, ...],
    iterations: int,
    bounded: bool,
) -> Changes:
    """Train what is added to last layers; each iteration sees all trials, turned and mirrored by the next symmetry.

    Args:
        features: z of each member, symmetry and trial ``(K, S, N, P)``.
        outputs: Median and raw gap that the layers begin with ``(K, S, N, 2)``.
        deviations: True deviations ``(N,)``, scaled to [0, 1].
        sets: Which trials each of C trainings sees ``(C, N)`` bool, at least one each.
        strengths: Penalties of ``|V|^2``, L of them.
        iterations: Steps of Adam.
        bounded: Whether the networks have a raw upper bound of their own.
    """
    members, symmetries, _, count = features.shape
    slopes = torch.zeros(members, len(sets), len(strengths), 2, count, requires_grad=True)
    shifts = torch.zeros(members, len(sets), len(strengths), 2, requires_grad=True)
    changes = Changes(slopes, shifts)
    sizes = sets.sum(dim=1)
    shares = (sets / sizes[:, None])[None, :, None]
    unit = torch.tensor([1.0, GAP_UNIT]) ** 2
    penalty = unit * torch.tensor(strengths)[:, None] / sizes[:, None, None]
    optimizer = torch.optim.Adam([slopes, shifts], lr=LEARNING_RATE)
    for step in range(iterations):
        for group in optimizer.param_groups:
            group["lr"] = LEARNING_RATE * 0.5 * (1 + math.cos(math.pi * step / iterations))
        turn = step % symmetries
        median, raw = (outputs[:, turn, None, None] + changes.outputs(features[:, turn])).unbind(dim=-1)
        errors = (deviations - median).abs()
        if bounded:
            above = deviations - median.detach() - functional.softplus(raw) - NARROWEST
            errors = errors + torch.maximum(QUANTILE * above, (QUANTILE - 1) * above)
        loss = (errors * shares).sum() + (penalty * slopes.square().sum(dim=-1)).sum()
        loss = loss + (SHIFT_STRENGTH / sizes[:, None, None] * unit * shifts.square()).sum()
        optimizer.zero_grad()
        loss.backward()
        optimizer.step()
    return Changes(slopes.detach(), shifts.detach())
