"""A deterministic training loop: AdamW, a cosine schedule, averaged weights, early stopping."""

import copy
import math
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Generator, Tensor, nn

Loss = Callable[[nn.Module, Tensor, Generator | None], Tensor]
"""``loss(network, indices, generator)``: mean loss of the samples; the generator draws augmentations, None: none."""

Report = Callable[["Epoch"], None]


@dataclass(frozen=True)
class TrainingSettings:
    """How a network is trained.

    Attributes:
        epochs: Most passes over the training samples.
        batch: Samples a step.
        learning_rate: Largest learning rate of AdamW.
        weight_decay: Its weight decay.
        warm_up: Share of all steps in which the rate grows from 0; then it falls to 0 along a cosine.
        clip: Largest norm of a step's gradient.
        average: Factor of the exponential average of the weights after each step; 0 keeps the last weights.
        patience: Epochs without a better validation loss after which the training stops.
        seed: Seed of the initial weights, the order of the samples and the augmentations.
        threads: Threads of the computation; results are the same to the bit for the same number.
        bfloat16: Whether layers compute in bfloat16, twice as fast where the processor can; weights stay float32.
    """

    epochs: int = 40
    batch: int = 32
    learning_rate: float = 2e-3
    weight_decay: float = 1e-2
    warm_up: float = 0.05
    clip: float = 1.0
    average: float = 0.99
    patience: int = 12
    seed: int = 0
    threads: int = 2
    bfloat16: bool = False


@dataclass(frozen=True)
class Epoch:
    """What one pass over the training samples gave: its number from 1, mean training and validation loss.

    Without samples for validation both are the training loss.
    """

    number: int
    training: float
    validation: float


@dataclass(frozen=True)
class History:
    """All epochs of a training, and the number of the one whose weights were kept."""

    epochs: tuple[Epoch, ...] = field(default=())
    best: int = 0


def train(
    network: nn.Module,
    loss: Loss,
    *,
    training: NDArray[np.integer],
    validation: NDArray[np.integer] | None,
    settings: TrainingSettings,
    report: Report = lambda epoch: None,
) -> History:
    """Train a network in place; it ends with the averaged weights of the epoch with the best validation loss.

    Args:
        network: The network, its initial weights made within `seeded`.
        loss: Loss of a batch of samples, given by their indices.
        training: Indices of the samples to train on ``(N,)``.
        validation: Indices of the samples that decide when to stop ``(M,)``; None: nothing does, the last averaged
            weights are kept.
        settings: How to train.
        report: Is told of every epoch, for a progress bar.

    Raises:
        ValueError: A part has no samples, or the loss is no longer finite.
    """
    judged = training if validation is None else validation
    if len(training) == 0 or len(judged) == 0:
        raise ValueError(f"expected samples in both parts, got {len(training)} and {len(judged)}")
    generator = Generator().manual_seed(settings.seed)
    samples, held_out = torch.from_numpy(np.asarray(training)), torch.from_numpy(np.asarray(judged))
    averaged = copy.deepcopy(network).eval().requires_grad_(False)
    optimizer = torch.optim.AdamW(
        network.parameters(), lr=settings.learning_rate, weight_decay=settings.weight_decay, fused=True
    )
    steps = settings.epochs * math.ceil(len(samples) / settings.batch)
    schedule = torch.optim.lr_scheduler.LambdaLR(optimizer, lambda step: _rate(step, steps, settings.warm_up))
    epochs: list[Epoch] = []
    step, best, kept = 0, 0, copy.deepcopy(network.state_dict())
    with threads(settings.threads):
        for number in range(1, settings.epochs + 1):
            network.train()
            total = 0.0
            for batch in samples[torch.randperm(len(samples), generator=generator)].split(settings.batch):
                optimizer.zero_grad()
                with _precision(settings):
                    value = loss(network, batch, generator)
                value.backward()
                nn.utils.clip_grad_norm_(network.parameters(), settings.clip)
                optimizer.step()
                schedule.step()
                total += float(value.detach()) * len(batch)
                step += 1
                _average(averaged, network, min(settings.average, step / (step + 10)))
            judgement = total / len(samples)
            if validation is not None:
                judgement = _mean_loss(averaged, loss, held_out, settings)
            epoch = Epoch(number, total / len(samples), judgement)
            if not (math.isfinite(epoch.training) and math.isfinite(epoch.validation)):
                raise ValueError(f"expected a finite loss, got {epoch}")
            if validation is None or not epochs or epoch.validation < epochs[best - 1].validation:
                best, kept = number, copy.deepcopy(averaged.state_dict())
            epochs.append(epoch)
            report(epoch)
            if number - best >= settings.patience:
                break
    network.load_state_dict(kept)
    network.eval()
    return History(tuple(epochs), best)


@contextmanager
def seeded(seed: int) -> Iterator[None]:
    """Draw a network's initial weights from a seed and leave the global generator as it was."""
    with torch.random.fork_rng(devices=[]):
        torch.manual_seed(seed)
        yield


@contextmanager
def threads(count: int) -> Iterator[None]:
    """Compute on this many threads."""
    before = torch.get_num_threads()
    torch.set_num_threads(count)
    try:
        yield
    finally:
        torch.set_num_threads(before)


@torch.no_grad()
def _mean_loss(network: nn.Module, loss: Loss, samples: Tensor, settings: TrainingSettings) -> float:
    with _precision(settings):
        return sum(float(loss(network, part, None)) * len(part) for part in samples.split(settings.batch)) / len(
            samples
        )


def _precision(settings: TrainingSettings) -> torch.autocast:
    return torch.autocast("cpu", torch.bfloat16, enabled=settings.bfloat16)


@torch.no_grad()
def _average(averaged: nn.Module, network: nn.Module, keep: float) -> None:
    for mean, value in zip(averaged.state_dict().values(), network.state_dict().values(), strict=True):
        if mean.is_floating_point():
            mean.lerp_(value, 1 - keep)
        else:
            mean.copy_(value)


def _rate(step: int, steps: int, warm_up: float) -> float:
    first = max(1.0, warm_up * steps)
    if step < first:
        return (step + 1) / first
    return 0.5 * (1 + math.cos(math.pi * min(1.0, (step - first) / max(1.0, steps - first))))
