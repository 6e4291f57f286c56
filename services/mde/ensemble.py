"""What is released as one MDE: networks trained on different parts of the data, calibrated together."""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor, nn

from common.domain.errors import ModelError, RequestError
from common.learning.weights import CARD, TENSORS, WeightsCard, parse_card, parse_tensors
from services.mde.distance import mahalanobis
from services.mde.familiarity import Familiarity
from services.mde.network import DeviationNetwork, Encoding
from services.mde.network_crop import CropNetwork
from services.mde.stacked_crop import StackedCrop
from services.mde.variants import VARIANTS

MOST_MEMBERS = 64


@dataclass(frozen=True)
class RawEstimates:
    """What an ensemble says before calibration.

    Attributes:
        median: Mean of the members' medians ``(B,)``.
        gap: Mean of their distances to the raw upper bound ``(B,)``.
        distance: Mean of their distances to the training data, 1 at the limit ``(B,)``.
    """

    median: NDArray[np.float64]
    gap: NDArray[np.float64]
    distance: NDArray[np.float64]


class Ensemble(nn.Module):
    """Networks of one variant, each with the mean and the spread of the descriptions that it was trained on.

    Attributes:
        means: Mean of each member's descriptions ``(K, F)``.
        whitenings: What makes them white ``(K, F, F)``.
        limits: Largest familiar distance ``(K,)``.
        facts: What the estimates rest on besides, float64 ``(5,)``: rows, columns and cell [m] of the grid, the
            deviation that counts as 1 [m], and the factor of the upper bound ``median + factor gap``.

    Args:
        members: The networks.
    """

    means: Tensor
    whitenings: Tensor
    limits: Tensor
    facts: Tensor

    def __init__(self, members: list[DeviationNetwork]) -> None:
        super().__init__()
        count, features = len(members), members[0].last.in_features
        self.members = nn.ModuleList(members)
        self.register_buffer("means", torch.zeros(count, features))
        self.register_buffer("whitenings", torch.zeros(count, features, features))
        self.register_buffer("limits", torch.ones(count))
        self.register_buffer("facts", torch.zeros(5, dtype=torch.float64))

    @property
    def networks(self) -> list[DeviationNetwork]:
        """The members."""
        return [member for member in self.members if isinstance(member, DeviationNetwork)]

    def encode(self, scene: Tensor, item: Tensor) -> list[Encoding]:
        """Return each member's encoding of states, see `DeviationNetwork.encode`."""
        return [member.encode(scene, item) for member in self.networks]

    def estimate(self, encodings: list[Encoding], actions: NDArray[np.float64]) -> tuple[Tensor, Tensor, Tensor]:
        """Return medians, gaps and distances, 1 at the limit, ``(K, B)`` each, for actions ``(B, 2)`` [m]."""
        parts = []
        for index, (member, encoding) in enumerate(zip(self.networks, encodings, strict=True)):
            descriptions = member.describe(encoding, actions)
            distance = mahalanobis(descriptions, self.means[index], self.whitenings[index]) / self.limits[index]
            parts.append((*member.estimate(descriptions), distance))
        medians, gaps, distances = (torch.stack(values) for values in zip(*parts, strict=True))
        return medians, gaps, distances


class Inference:
    """A trained ensemble that answers: encodes states and estimates actions in them, no gradients kept.

    Args:
        ensemble: The networks, in evaluation mode.
    """

    def __init__(self, ensemble: Ensemble) -> None:
        crops = [member for member in ensemble.networks if isinstance(member, CropNetwork)]
        self._stacked = None
        if len(crops) == len(ensemble.networks):
            self._stacked = StackedCrop(crops, ensemble.means, ensemble.whitenings, ensemble.limits)
        self._ensemble = ensemble
        self.pooling = ensemble.networks[0].pooling

    @torch.inference_mode()
    def encode(self, scene: Tensor, item: Tensor) -> Sequence[Encoding]:
        """Encode one state from the `inputs` of scene and item."""
        if self._stacked is not None:
            return (self._stacked.encode(scene, item),)
        return self._ensemble.encode(scene, item)

    @torch.inference_mode()
    def estimate(self, encodings: Sequence[Encoding], actions: NDArray[np.float64]) -> RawEstimates:
        """Estimate the deviations for actions ``(B, 2)`` [m]."""
        if self._stacked is not None:
            found = self._stacked.estimate(encodings[0], actions)
        else:
            found = self._ensemble.estimate(list(encodings), actions)
        return RawEstimates(*(values.mean(dim=0).double().numpy() for values in found))


@dataclass(frozen=True)
class Calibrated:
    """An ensemble with all that its card says.

    Attributes:
        ensemble: The networks.
        card: The card.
        familiarity: What the training data covers.
    """

    ensemble: Ensemble
    card: WeightsCard
    familiarity: Familiarity

    @property
    def factor(self) -> float:
        """The upper bound is ``median + factor gap``."""
        return float(self.ensemble.facts[-1])


def build(card: WeightsCard) -> Ensemble:
    """Return an ensemble with the sizes on a card and no training.

    Raises:
        ModelError: The card names an unknown architecture, or sizes that it does not have.
    """
    if card.architecture not in VARIANTS:
        raise ModelError(f"{card.name}: expected an architecture of {', '.join(VARIANTS)}, got {card.architecture!r}")
    try:
        members, sizes = int(card.settings["members"]), dict(card.settings["network"])
        if not 1 <= members <= MOST_MEMBERS:
            raise ValueError(f"expected 1 to {MOST_MEMBERS} members")
        sizes = {name: tuple(size) if isinstance(size, list) else size for name, size in sizes.items()}
        return Ensemble([VARIANTS[card.architecture](card.grid.grid(), **sizes) for _ in range(members)])
    except (KeyError, TypeError, ValueError, IndexError, RuntimeError, RequestError) as error:
        raise ModelError(f"{card.name}: settings: expected those of {card.architecture}, got {error!r:.200}") from None


def load_ensemble(folder: Path, *, model: str) -> Calibrated:
    """Load the MDE of a model.

    Raises:
        ModelError: The card is of another model or architecture, or lies about weights, grid, scale or calibration.
    """
    for name in (CARD, TENSORS):
        if not (folder / name).is_file():
            raise ModelError(f"weights: expected {folder / name}, got no such file")
    return parse_ensemble((folder / CARD).read_bytes(), (folder / TENSORS).read_bytes(), model=model, where=str(folder))


def parse_ensemble(card_json: bytes, tensors: bytes, *, model: str, where: str) -> Calibrated:
    """Return the MDE of a model from the bytes of its card and its weights, checked as `load_ensemble` does.

    A card that tells of larger networks than its tensors are costs no memory. ``where`` names both in errors.
    """
    card = parse_card(card_json, where=f"{where}/{CARD}", name=f"mde_{model}")
    with torch.device("meta"):
        expected = build(card).state_dict()
    found = parse_tensors(tensors, expected, card=card, where=where)
    ensemble = build(card)
    ensemble.load_state_dict(found)
    ensemble.eval().requires_grad_(False)
    _check_facts(where, ensemble, card)
    try:
        familiarity = Familiarity.from_statistics(card.grid.grid(), card.statistics)
    except (KeyError, TypeError, ValueError) as error:
        raise ModelError(f"{where}: statistics: expected what the data covers, got {error!r:.200}") from None
    return Calibrated(ensemble, card, familiarity)


def facts(card: WeightsCard, *, factor: float) -> Tensor:
    """Return `Ensemble.facts` as a card tells them."""
    grid, scale = card.grid, card.deviation_scale_m
    return torch.tensor([grid.rows, grid.columns, grid.cell, scale or math.nan, factor], dtype=torch.float64)


def _check_facts(where: str, ensemble: Ensemble, card: WeightsCard) -> None:
    """Raise `ModelError` if a card says something else than the weights do."""
    rows, columns, cell, scale, factor = ensemble.facts.tolist()
    if (rows, columns, cell) != (card.grid.rows, card.grid.columns, card.grid.cell):
        raise ModelError(
            f"{where}: grid: expected {rows:g} x {columns:g} cells of {cell:g} m as in the weights, "
            f"got {card.grid.grid()} on the card"
        )
    if scale != card.deviation_scale_m or not scale > 0:
        raise ModelError(
            f"{where}: deviation_scale_m: expected {scale:g} as in the weights, got {card.deviation_scale_m}"
        )
    if not math.isfinite(factor):
        raise ModelError(f"{where}: expected a finite factor of the upper bound, got {factor}")
