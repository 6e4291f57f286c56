"""Train the networks of one MDE on parts of the data each, and calibrate them together on states that none has seen."""

from collections.abc import Callable, Mapping
from dataclasses import asdict, dataclass, field, replace
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Generator, Tensor, nn

from common.domain.grid import Grid
from common.learning.features import SYMMETRIES, transform, transform_actions
from common.learning.splits import folds, split
from common.learning.training import Epoch, TrainingSettings, seeded, train
from pipelines.mde.examples import Examples
from services.mde.calibration import conformal_factor
from services.mde.distance import mahalanobis, whitening
from services.mde.ensemble import Ensemble, RawEstimates
from services.mde.network import DeviationNetwork, inputs
from services.mde.variants import VARIANTS

Report = Callable[[int, Epoch], None]


TRAINING = TrainingSettings(
    epochs=20, batch=32, learning_rate=2e-3, weight_decay=0.2, patience=20, threads=1, bfloat16=True
)
COVERAGE = 0.9
HELD_OUT = 0.15
"""Share of the states that a single member is not trained on, to decide which of its epochs is kept."""

CALIBRATION, EVERYONE = -1, -2
"""Parts of the states that none, and that all members are trained on."""


@dataclass(frozen=True)
class EnsembleSettings:
    """How an MDE is trained.

    Attributes:
        variant: Name of the network, see `services.mde.variants`.
        network: Its sizes, where they are not the default.
        calibration_share: Share of the states that are kept for the calibration.
        members: Number of parts of the other states; each member is trained without one of them. A single member is
            trained without `HELD_OUT` of them.
        coverage: Share of new samples for which the upper bound is to hold.
        familiar: Share of the calibration's samples that count as familiar.
        training: How each member is trained; its seed is that of the whole.
    """

    variant: str = "crop"
    network: Mapping[str, Any] = field(default_factory=dict[str, Any])
    calibration_share: float = 0.2
    members: int = 4
    coverage: float = COVERAGE
    familiar: float = 0.99
    training: TrainingSettings = TRAINING


def default_settings(
    variant: str, *, seed: int, epochs: int | None = None, coverage: float = COVERAGE
) -> EnsembleSettings:
    """Return how the released networks of a variant are trained: ours as an ensemble, the paper's as one network.

    Args:
        variant: Name of the network.
        seed: Seed of everything random.
        epochs: Passes over the data, None: the usual number.
        coverage: Share of new samples for which the upper bound is to hold.
    """
    training = replace(TRAINING, seed=seed)
    if epochs is not None:
        training = replace(training, epochs=epochs, patience=epochs)
    members = 1 if variant == "paper" else 4
    return EnsembleSettings(variant=variant, members=members, coverage=coverage, training=training)


@dataclass(frozen=True)
class Trained:
    """A trained ensemble.

    Attributes:
        ensemble: The networks.
        calibration: Indices of the samples that none of them was trained on ``(C,)``.
        held_out: What they say about these together.
        factor: The upper bound is ``median + factor gap``.
    """

    ensemble: Ensemble
    calibration: NDArray[np.int64]
    held_out: RawEstimates
    factor: float


def train_ensemble(
    examples: Examples, grid: Grid, settings: EnsembleSettings, *, report: Report = lambda member, epoch: None
) -> Trained:
    """Train an ensemble; the same examples and settings give the same weights.

    Args:
        examples: The training samples.
        grid: Their grid.
        settings: How to train.
        report: Told of every epoch of every member.
    """
    samples, seed = examples.samples, settings.training.seed
    part = parts(samples.groups, settings)
    calibration = np.flatnonzero(part == CALIBRATION)
    with seeded(seed):
        members = [VARIANTS[settings.variant](grid, **settings.network) for _ in range(settings.members)]
    data = Tensors.of(examples, members[0].pooling)
    ensemble = Ensemble(members)
    found: list[tuple[NDArray[np.float64], ...]] = []
    for index, member in enumerate(members):
        seen = np.flatnonzero((part != index) & (part != CALIBRATION))
        member_seed = seed * settings.members + index
        with seeded(member_seed):  # dropout draws from the global generator
            train(
                member,
                data.loss,
                training=seen,
                validation=np.flatnonzero(part == index),
                settings=replace(settings.training, seed=member_seed),
                report=lambda epoch, index=index: report(index, epoch),
            )
        mean, whiten = whitening(data.evaluate(member, seen)[0])
        descriptions, medians, gaps = data.evaluate(member, calibration)
        distances = mahalanobis(descriptions, mean, whiten)
        limit = torch.quantile(distances, settings.familiar)
        ensemble.means[index], ensemble.whitenings[index], ensemble.limits[index] = mean, whiten, limit
        found.append(tuple(values.double().numpy() for values in (medians, gaps, distances / limit)))
    held_out = RawEstimates(*np.mean(found, axis=0))
    factor = conformal_factor(
        examples.deviations[calibration], held_out.median, held_out.gap, coverage=settings.coverage
    )
    return Trained(ensemble, calibration, held_out, factor)


def settings_card(settings: EnsembleSettings) -> dict[str, Any]:
    """Return the settings as they stand on a card."""
    return {**asdict(settings), "network": dict(settings.network)}


def parts(groups: NDArray[np.integer], settings: EnsembleSettings) -> NDArray[np.int64]:
    """Return the member that is not trained on each sample ``(N,)``, or `CALIBRATION`, or `EVERYONE`."""
    seed = settings.training.seed
    training, calibration = split(groups, share=settings.calibration_share, seed=seed)
    part = np.full(len(groups), EVERYONE)
    part[calibration] = CALIBRATION
    if settings.members > 1:
        part[training] = folds(groups[training], count=settings.members, seed=seed)
    else:
        part[training[split(groups[training], share=HELD_OUT, seed=seed)[1]]] = 0
    return part


@dataclass(frozen=True)
class Tensors:
    """The examples as a network sees them."""

    scene: Tensor
    item: Tensor
    actions: NDArray[np.float64]
    deviations: Tensor

    @classmethod
    def of(cls, examples: Examples, pooling: int) -> "Tensors":
        """Return examples as networks with this pooling see them."""
        samples = examples.samples
        return cls(
            inputs(samples.scene_heights, samples.scene_materials, pooling),
            inputs(samples.item_heights, samples.item_materials, pooling),
            samples.actions,
            torch.from_numpy(examples.deviations),
        )

    def loss(self, network: nn.Module, samples: Tensor, generator: Generator | None) -> Tensor:
        """Return the mean of ``|d - m|`` and the pinball loss of the raw upper bound at 0.9."""
        assert isinstance(network, DeviationNetwork)
        scene, item, actions = self.scene[samples], self.item[samples], self.actions[samples.numpy()]
        if generator is not None and network.symmetric:
            scene, item, actions = _turned(scene, item, actions, generator)
        median, gap = network.estimate(network.describe(network.encode(scene, item), actions))
        truth = self.deviations[samples]
        error = (truth - median).abs().mean()
        if not network.bounded:
            return error
        above = truth - median.detach() - gap
        return error + torch.maximum(0.9 * above, -0.1 * above).mean()

    @torch.inference_mode()
    def evaluate(self, network: DeviationNetwork, samples: NDArray[np.integer]) -> tuple[Tensor, Tensor, Tensor]:
        """Return descriptions ``(N, F)``, medians and gaps ``(N,)``."""
        parts = []
        for chunk in torch.from_numpy(samples).split(64):
            encoding = network.encode(self.scene[chunk], self.item[chunk])
            descriptions = network.describe(encoding, self.actions[chunk.numpy()])
            parts.append((descriptions, *network.estimate(descriptions)))
        descriptions, medians, gaps = (torch.cat(values) for values in zip(*parts, strict=True))
        return descriptions, medians, gaps


def _turned(
    scene: Tensor, item: Tensor, actions: NDArray[np.float64], generator: Generator
) -> tuple[Tensor, Tensor, NDArray[np.float64]]:
    """Turn and mirror each sample as one of the plate's symmetries, drawn for it."""
    drawn = torch.randint(SYMMETRIES, (len(scene),), generator=generator)
    scene, item, actions = torch.empty_like(scene).copy_(scene), torch.empty_like(item).copy_(item), actions.copy()
    for symmetry in range(SYMMETRIES):
        chosen = drawn == symmetry
        scene[chosen], item[chosen] = transform(scene[chosen], symmetry), transform(item[chosen], symmetry)
        actions[chosen.numpy()] = transform_actions(actions[chosen.numpy()], symmetry)
    return scene, item, actions
