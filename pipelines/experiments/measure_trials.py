"""MDEs fine-tuned on more and more trials: by several methods, and with trials that are chosen."""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
from numpy.typing import NDArray

from common.learning.weights import read_card
from pipelines.evaluate.family import versions
from pipelines.experiments.case_sets import find_cases
from pipelines.experiments.finetunings import Weights, judged, predicted_trials, true_deviations
from pipelines.experiments.parameters import ActiveChoice, SampleSize
from pipelines.experiments.place import Place, Report
from pipelines.experiments.raw import FILE, Row, collect
from pipelines.mde.active import choose_next, points_of
from pipelines.mde.active_belief import believe
from pipelines.mde.active_representative import order_of
from pipelines.mde.finetune import FinetuneSettings, Method, release_finetuned
from pipelines.mde.trials import Trials
from services.mde.ensemble import load_ensemble


def measure_sample_size(parameters: SampleSize, folder: Path, place: Place, report: Report) -> None:
    """Fine-tune an MDE on the first so many of shuffled trials, by every method and seed, and judge the test trials.

    Before any trial there is only the sim-to-sim MDE: method ``s2s``, 0 trials.
    """
    cases, trials = find_cases(place.data, parameters.cases), find_cases(place.data, parameters.trials)
    kinds = [
        f"{method}/{count}/{seed}"
        for method in parameters.methods
        for count in parameters.counts
        for seed in parameters.seeds
    ]
    jobs = dict.fromkeys([f"s2s/0/{seed}" for seed in parameters.seeds] + kinds, len(cases))
    sets = {"cases": cases.about(), "trials": trials.about()}
    about = {**parameters.about(), **sets, **versions(place.weights(parameters.weights))}
    collect(folder / FILE, about, jobs, _Growing(parameters, place), workers=place.workers, report=report)


def measure_active(parameters: ActiveChoice, folder: Path, place: Place, report: Report) -> None:
    """Choose trials one after the other by every acquisition, and fine-tune at some numbers of them.

    Before each choice the MDE's belief is that of all trials so far. Seeds draw the first trials, which all
    acquisitions share, and what is random in a choice.
    """
    cases, pool = find_cases(place.data, parameters.cases), find_cases(place.data, parameters.trials)
    jobs = {
        f"{acquisition}/{seed}": len(parameters.counts) * len(cases)
        for acquisition in parameters.acquisitions
        for seed in parameters.seeds
    }
    sets = {"cases": cases.about(), "trials": pool.about()}
    about = {**parameters.about(), **sets, **versions(place.weights(parameters.weights))}
    collect(folder / FILE, about, jobs, _Choosing(parameters, place), workers=place.workers, report=report)


@dataclass(frozen=True)
class _Growing:
    """Fine-tunes on some trials."""

    parameters: SampleSize
    place: Place

    def __call__(self, job: str) -> list[Row]:
        """Return the rows of a job ``<method>/<trials>/<seed>``."""
        method, count, seed = job.split("/")
        subject = Subjects(self.parameters, self.place)
        about: Row = {"model": self.parameters.model, "method": method, "trials": int(count), "seed": int(seed)}
        if method == "s2s":
            return [{**about, **row} for row in subject.rows(subject.base)]
        order = np.random.default_rng([int(seed), 7]).permutation(len(subject.trials))
        chosen = np.sort(order[: int(count)])
        assert method in ("last", "full", "scratch", "calibration")
        return [{**about, **row} for row in subject.tuned(chosen, method=method, seed=int(seed))]


@dataclass(frozen=True)
class _Choosing:
    """Chooses trials by one acquisition."""

    parameters: ActiveChoice
    place: Place

    def __call__(self, job: str) -> list[Row]:
        """Return the rows of a job ``<acquisition>/<seed>``."""
        parameters, (acquisition, seed) = self.parameters, job.split("/")
        subject = Subjects(parameters, self.place)
        base, pairs = load_ensemble(subject.base, model=parameters.model), subject.trials.pairs()
        scaled = np.clip(subject.trials.deviation_m / (base.card.deviation_scale_m or np.nan), 0, 1)
        points = points_of(base, parameters.model, pairs)
        order = np.random.default_rng([int(seed), 11]).permutation(len(pairs))
        chosen: list[int] = order[: parameters.first].tolist()
        rows: list[Row] = []
        for count in range(parameters.first, max(parameters.counts) + 1):
            if count in parameters.counts:
                about: Row = {"model": parameters.model, "method": acquisition, "trials": count, "seed": int(seed)}
                tuned = subject.tuned(np.sort(chosen), method="last", seed=int(seed))
                rows += [{**about, **row} for row in tuned]
            if count == max(parameters.counts):
                break
            if acquisition == "representative":
                chosen = order_of(points.described, chosen, count + 1)
                continue
            left = [index for index in range(len(pairs)) if index not in chosen]
            belief = believe(points.part(chosen), scaled[chosen], points.part(left), candidates=len(left))
            assert acquisition in ("random", "lcb", "variance", "integrated")
            (picked,) = choose_next(belief, acquisition, seed=1000 * int(seed) + count)
            chosen.append(left[picked])
        return rows


class Subjects:
    """An MDE, the trials that it may learn from, and the test trials.

    Args:
        parameters: What is measured.
        place: Where everything is.
    """

    def __init__(self, parameters: SampleSize | ActiveChoice, place: Place) -> None:
        weights: Weights = tuple(place.weights(parameters.weights).items())
        self.model = parameters.model
        self.base = dict(weights)[f"mde_{parameters.model}"]
        self.trials: Trials = predicted_trials(place.data, parameters.trials, self.model, weights)
        self._cases = find_cases(place.data, parameters.cases)
        self._deviations_m = true_deviations(place.data, parameters.cases, self.model, weights)

    def rows(self, folder: Path, *, constant: float | None = None) -> list[Row]:
        """Return what the MDE in a folder says about the test trials, and the error of a constant beside it."""
        scale_m = read_card(self.base).deviation_scale_m or np.nan
        if constant is None:
            constant = float(np.median(np.clip(self.trials.deviation_m / scale_m, 0, 1)))
        return [{"constant": constant, **row} for row in judged(folder, self.model, self._cases, self._deviations_m)]

    def tuned(self, chosen: NDArray[np.integer] | Sequence[int], *, method: Method, seed: int) -> list[Row]:
        """Return what an MDE says that was fine-tuned on some of the trials."""
        base, trials = load_ensemble(self.base, model=self.model), self.trials.subset(np.asarray(chosen))
        scaled = np.clip(trials.deviation_m / (base.card.deviation_scale_m or np.nan), 0, 1)
        with TemporaryDirectory() as folder:
            release_finetuned(base, trials, Path(folder), FinetuneSettings(method=method, seed=seed))
            return self.rows(Path(folder), constant=float(np.median(scaled)))
