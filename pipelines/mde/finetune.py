"""Make a sim-to-real MDE of a sim-to-sim one: fine-tune it on real trials, and write it with its card."""

from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from common.domain.errors import RequestError
from common.domain.scene import State
from common.learning.training import threads
from common.learning.weights import DatasetCard, WeightsCard, save, tensors_sha256
from common.tasks.plating import Plating
from pipelines.mde.examples import Examples
from pipelines.mde.finetune_last import finetune_last
from pipelines.mde.finetune_networks import finetune_full, train_scratch
from pipelines.mde.finetuned import Bound, Finetuned, calibrate
from pipelines.mde.release import declared_threshold, deviations_digest
from pipelines.mde.scores import acceptance, coverage, mean_absolute_error
from pipelines.mde.trials import Trials
from services.mde.ensemble import Calibrated, facts
from services.mde.estimator import NetworkEstimator
from services.mde.familiarity import Familiarity

Method = Literal["last", "full", "scratch", "calibration"]
ITERATIONS = 500
"""As in the paper."""

FEWEST = 2
"""States that the trials must come from: one is judged by what was learned from the others."""

TRUSTED = Plating.trusted
"""The model that sim-to-sim deviations are from: its own is 0."""


@dataclass(frozen=True)
class FinetuneSettings:
    """How an MDE is fine-tuned.

    Attributes:
        method: ``last`` trains the last layers, ``full`` all weights, ``scratch`` new networks on the trials alone,
            ``calibration`` a shift and a scale of the estimates.
        iterations: Steps of the training.
        seed: Seed of everything random.
        coverage: Share of new samples for which the upper bound is to hold.
    """

    method: Method = "last"
    iterations: int = ITERATIONS
    seed: int = 0
    coverage: float = 0.9


@dataclass(frozen=True)
class Tuned:
    """A fine-tuned MDE before it is written.

    Attributes:
        finetuned: The networks and what they say unseen.
        bound: Their upper bound.
        before: What the sim-to-sim MDE says about the trials ``(N,)``; 0 for the trusted model, which has none.
        before_upper: Its upper bound ``(N,)``.
    """

    finetuned: Finetuned
    bound: Bound
    before: NDArray[np.float64]
    before_upper: NDArray[np.float64]


def finetune(base: Calibrated, trials: Trials, settings: FinetuneSettings) -> Tuned:
    """Fine-tune an MDE on trials; the same base, trials and settings give the same weights.

    Args:
        base: The sim-to-sim MDE of the model, or that of another one.
        trials: The trials, with the model's deviations.
        settings: How.

    Raises:
        RequestError: The trials are on another grid, or of too few states.
    """
    examples, states = examples_of(base, trials), len(np.unique(trials.samples.groups))
    if states < FEWEST:
        raise RequestError(f"trials: expected {FEWEST} or more of different states, got {states}")
    with threads(1):
        return _finetune(base, trials, examples, settings)


def _finetune(base: Calibrated, trials: Trials, examples: Examples, settings: FinetuneSettings) -> Tuned:
    arguments = {"iterations": settings.iterations, "seed": settings.seed}
    if settings.method == "full":
        found = finetune_full(base, examples, **arguments)
    elif settings.method == "scratch":
        found = train_scratch(base, examples, **arguments)
    else:
        scaled_only, anew = settings.method == "calibration", not _is_of(base, trials.model)
        found = finetune_last(base, examples, scaled_only=scaled_only, anew=anew, **arguments)
    least = None if settings.method == "scratch" else base.factor
    truth = examples.deviations[found.judged].astype(np.float64)
    bound = calibrate(truth, found.median, found.gap, coverage=settings.coverage, least=least)
    told = [sim_to_sim(base, trials.model, state, actions) for state, actions in trials.pairs()]
    before, upper = (np.concatenate(values) for values in zip(*told, strict=True))
    return Tuned(found, bound, before, upper)


def release_finetuned(
    base: Calibrated, trials: Trials, folder: Path, settings: FinetuneSettings, *, version: str | None = None
) -> WeightsCard:
    """Fine-tune an MDE on trials, write it to a folder and return its card.

    Args:
        base: As of `finetune`.
        trials: As of `finetune`.
        folder: Where to write.
        settings: How.
        version: The new version; None: that of the base, ``-s2r-`` and eight digits of the weights' SHA-256.
    """
    tuned, examples = finetune(base, trials, settings), examples_of(base, trials)
    ensemble, card = tuned.finetuned.ensemble, base.card
    finetuning = {
        **asdict(settings),
        **tuned.finetuned.chosen,
        "base": {"name": card.name, "version": card.version, "sha256": card.sha256},
    }
    complete = card.model_copy(
        update={
            "name": f"mde_{trials.model}",
            "version": "",
            "dataset": DatasetCard(name=trials.name, seed=0, version=trials.digest[:16], samples=len(trials)),
            "seed": settings.seed,
            "settings": {**card.settings, "coverage": settings.coverage, "finetuning": finetuning},
            "metrics": _metrics(tuned, trials, examples),
            "statistics": _covered(base, trials, settings.method).statistics(),
        }
    )
    ensemble.facts.copy_(facts(complete, factor=tuned.bound.factor))
    tensors = ensemble.state_dict()
    named = version or f"{card.version}-s2r-{tensors_sha256(tensors)[:8]}"
    return save(folder, tensors, complete.model_copy(update={"version": named}))


def examples_of(base: Calibrated, trials: Trials) -> Examples:
    """Return the trials with their deviations on the scale of the base, or say why they do not fit it."""
    samples, grid = trials.samples, base.familiarity.grid
    if trials.grid != grid:
        raise RequestError(f"trials: expected {grid} as of {base.card.name}, got {trials.grid}")
    assert base.card.deviation_scale_m is not None  # as loaded
    return Examples.of(samples, trials.deviation_m, base.card.deviation_scale_m)


def _is_of(base: Calibrated, model: str) -> bool:
    return base.card.name == f"mde_{model}"


def sim_to_sim(
    base: Calibrated, model: str, state: State, actions: NDArray[np.float64]
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return mean and upper bound ``(B,)`` that an MDE states for a model and actions ``(B, 2)`` [m].

    The trusted model has no sim-to-sim MDE: both are 0 unless the MDE is its own, made of trials.
    """
    if model == TRUSTED and not _is_of(base, TRUSTED):
        return np.zeros(len(actions)), np.zeros(len(actions))
    found = NetworkEstimator(base).estimate(state, actions)
    return found.mean, found.upper


def _covered(base: Calibrated, trials: Trials, method: Method) -> Familiarity:
    """Return what the weights know: new networks the trials alone, others what the base knew as well."""
    samples, grid = trials.samples, base.familiarity.grid
    states = samples.scene_heights, samples.scene_materials, samples.item_heights, samples.item_materials
    if method == "scratch":
        return Familiarity.of(grid, *states, actions=samples.actions)
    return base.familiarity.extended(*states, actions=samples.actions)


def _metrics(tuned: Tuned, trials: Trials, examples: Examples) -> dict[str, Any]:
    """Return figures of the trials, the new ones by networks that did not see them."""
    truth, found, bound = examples.deviations.astype(np.float64), tuned.finetuned, tuned.bound
    median, d_max = found.median.clip(0, 1), declared_threshold(examples.deviations)
    return {
        "model_version": trials.model_version,
        "deviations_sha256": deviations_digest(trials.deviation_m),
        "d_max": d_max,
        "deviation_mean": float(truth.mean()),
        "trials": len(trials),
        "trials_left_out": len(trials.left_out),
        "before": {
            "samples": len(truth),
            "mae": mean_absolute_error(truth, tuned.before),
            "coverage": coverage(truth, tuned.before_upper),
        },
        "held_out": {
            "samples": len(found.judged),
            "mae": mean_absolute_error(truth[found.judged], median),
            "median_baseline_mae": mean_absolute_error(truth, np.full_like(truth, np.median(truth))),
            "coverage": bound.coverage,
            **asdict(acceptance(truth[found.judged], median, d_max=d_max)),
        },
        "bound_factor": bound.rests_on,
    }
