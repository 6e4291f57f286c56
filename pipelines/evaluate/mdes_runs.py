"""The raw results behind Table II: what MDEs of several seeds and variants say about every test sample."""

import json
from collections.abc import Iterable
from dataclasses import asdict, dataclass
from pathlib import Path
from statistics import median
from time import perf_counter

import numpy as np

from common.domain.errors import ModelError
from common.domain.scene import State
from common.learning.weights import read_card
from common.storage.dataset import Dataset
from pipelines.mde.release import deviations_digest, release
from pipelines.mde.subject import Subject
from pipelines.mde.train import EnsembleSettings, Report, settings_card
from services.mde.estimator import NetworkEstimator, read_estimator

BATCH = 16
"""Actions in the batches that are timed."""


@dataclass(frozen=True)
class Judgement:
    """What one MDE says about one test sample; deviations are scaled to [0, 1].

    Attributes:
        model: The model whose deviation is estimated.
        variant: The network, ``crop`` or ``paper``.
        seed: Seed of its training.
        sample: Number of the test sample.
        group: Number of its state.
        truth: True deviation.
        mean: Estimate.
        upper: Calibrated upper bound.
        familiar: Whether the MDE knows such inputs.
    """

    model: str
    variant: str
    seed: int
    sample: int
    group: int
    truth: float
    mean: float
    upper: float
    familiar: bool


@dataclass(frozen=True)
class Run:
    """All judgements of one MDE, and what they rest on.

    Attributes:
        judgements: One for each test sample.
        d_max: Threshold that its card declares.
        scale_m: Deviation that counts as 1 [m].
        nominal_coverage: Share of samples for which the upper bound is to hold.
        median_of_training: Median of the training deviations: what a constant would say.
        action_s: Time for an action, the median over batches of 16 in states seen before [s].
        state_s: Time for the first action of a new state, median [s].
        sha256: Of the weights.
    """

    judgements: tuple[Judgement, ...]
    d_max: float
    scale_m: float
    nominal_coverage: float
    median_of_training: float
    action_s: float
    state_s: float
    sha256: str


def find_weights(
    dataset: Dataset,
    subject: Subject,
    settings: EnsembleSettings,
    *,
    scale_m: float,
    released: Path,
    work: Path,
    report: Report = lambda member, epoch: None,
) -> Path:
    """Return the folder of weights that were trained like this: the released ones, earlier ones, or new ones.

    Args:
        dataset: The data set.
        subject: The model.
        settings: How to train.
        scale_m: Deviation that counts as 1 [m].
        released: Folder of the released weights of this MDE.
        work: Folder for weights that are not there yet.
        report: Told of every epoch.
    """
    folder = work / f"mde_{subject.name}-{settings.variant}-{settings.training.seed}"
    for candidate in (released, folder):
        if _is_the_same(candidate, dataset, subject, settings, scale_m):
            return candidate
    release(
        dataset,
        subject.name,
        subject.train_m,
        folder,
        settings,
        model_version=subject.version,
        scale_m=scale_m,
        report=report,
    )
    return folder


def judge(dataset: Dataset, subject: Subject, folder: Path) -> Run:
    """Ask the MDE in a folder about every test sample, on one thread."""
    estimator = read_estimator(folder, model=subject.name, threads=1)
    card, samples = read_card(folder), dataset.samples("test")
    scale_m = card.deviation_scale_m or np.nan
    judgements: list[Judgement] = []
    action_s, state_s = [], []
    for group in np.unique(samples.groups):
        state = dataset.state("test", int(group))
        (members,) = np.nonzero(samples.groups == group)
        began = perf_counter()
        estimates = estimator.estimate(state, samples.actions[members])
        state_s.append(perf_counter() - began)
        action_s.append(_time_batch(estimator, state))
        for place, sample in enumerate(members):
            judgements.append(
                Judgement(
                    model=subject.name,
                    variant=card.architecture,
                    seed=card.seed,
                    sample=int(sample),
                    group=int(group),
                    truth=float(np.clip(subject.test_m[sample] / scale_m, 0, 1)),
                    mean=float(estimates.mean[place]),
                    upper=float(estimates.upper[place]),
                    familiar=bool(estimates.familiar[place]),
                )
            )
    return Run(
        judgements=tuple(sorted(judgements, key=lambda one: one.sample)),
        d_max=float(card.metrics["d_max"]),
        scale_m=scale_m,
        nominal_coverage=float(card.settings["coverage"]),
        median_of_training=float(np.median(np.clip(subject.train_m / scale_m, 0, 1))),
        action_s=median(action_s),
        state_s=median(state_s),
        sha256=card.sha256,
    )


def write_runs(path: Path, runs: Iterable[Run]) -> None:
    """Write runs as JSON Lines: for each one line about it, then one line a judgement."""
    lines: list[str] = []
    for run in runs:
        about = {name: value for name, value in vars(run).items() if name != "judgements"}
        lines.append(json.dumps({"run": about}))
        lines += [json.dumps(asdict(judgement)) for judgement in run.judgements]
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text("\n".join(lines) + "\n")


def read_runs(path: Path) -> tuple[Run, ...]:
    """Read what `write_runs` wrote."""
    found: list[tuple[dict[str, float], list[Judgement]]] = []
    for line in path.read_text().splitlines():
        fields = json.loads(line)
        if "run" in fields:
            found.append((fields["run"], []))
        else:
            found[-1][1].append(Judgement(**fields))
    return tuple(Run(judgements=tuple(judgements), **about) for about, judgements in found)  # type: ignore[arg-type]


def _is_the_same(folder: Path, dataset: Dataset, subject: Subject, settings: EnsembleSettings, scale_m: float) -> bool:
    try:
        card = read_card(folder, name=f"mde_{subject.name}")
    except ModelError:
        return False
    data = dataset.card
    return (
        (card.dataset.name, card.dataset.seed, card.dataset.version) == (data.name, data.seed, data.version)
        and card.metrics.get("deviations_sha256") == deviations_digest(subject.train_m)
        and card.settings == json.loads(json.dumps(settings_card(settings)))
        and card.deviation_scale_m == scale_m
    )


def _time_batch(estimator: NetworkEstimator, state: State, *, repeats: int = 3) -> float:
    """Return the shortest time an action of a batch takes in a state that was seen before [s]."""
    actions = np.random.default_rng(0).uniform(-0.06, 0.06, (BATCH, 2))
    times = []
    for _ in range(repeats):
        began = perf_counter()
        estimator.estimate(state, actions)
        times.append(perf_counter() - began)
    return min(times) / BATCH
