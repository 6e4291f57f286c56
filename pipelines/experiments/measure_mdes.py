"""What MDEs of several seeds say about test samples: a row for each model, seed and sample."""

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from common.storage.dataset import Dataset
from pipelines.evaluate.family import find_member, versions
from pipelines.evaluate.mdes_runs import find_weights
from pipelines.experiments.case_sets import find_cases
from pipelines.experiments.finetunings import judged, predicted_trials, true_deviations
from pipelines.experiments.parameters import Cases, MdeErrors
from pipelines.experiments.place import Place, Report
from pipelines.experiments.raw import FILE, Row, collect
from pipelines.mde.crossfit import OtherSamplesError, read_deviations
from pipelines.mde.examples import deviation_scale
from pipelines.mde.finetune import FinetuneSettings, release_finetuned
from pipelines.mde.subject import Subject
from pipelines.mde.train import default_settings
from services.mde.ensemble import load_ensemble

WEIGHTS = "weights"
"""Folder of trained weights beside the raw results."""


def measure_mdes(parameters: MdeErrors, folder: Path, place: Place, report: Report) -> None:
    """Train MDEs that are not there, on the training split, and ask each about every test sample."""
    cases = find_cases(place.data, parameters.cases)
    real = find_cases(place.data, parameters.real) if parameters.real else None
    trials = find_cases(place.data, parameters.trials) if parameters.trials else None
    stages = 1 + (len(parameters.ways) if trials else 0)
    rows = len(cases) + (stages * len(real) if real else 0)
    jobs = {f"{model}/{seed}": rows for model in parameters.models for seed in parameters.seeds}
    sets = {"cases": cases.about(), "real": real and real.about(), "trials": trials and trials.about()}
    about = {**parameters.about(), **sets, **versions(place.weights(parameters.weights))}
    work = _Work(parameters, place, folder / WEIGHTS)
    collect(folder / FILE, about, jobs, work, workers=place.workers, report=report)


@dataclass(frozen=True)
class _Work:
    """Trains one MDE and judges it."""

    parameters: MdeErrors
    place: Place
    work: Path

    def __call__(self, job: str) -> list[Row]:
        """Return the rows of a job ``<model>/<seed>``."""
        name, seed = job.split("/")
        weights = self.place.weights(self.parameters.weights)
        dataset = Dataset.open(self.place.data / self.parameters.cases.data)
        subject, scale_m = find_subject(dataset, name, weights), deviation_scale(dataset)
        s2s = find_weights(
            dataset,
            subject,
            default_settings("crop", seed=int(seed), epochs=self.parameters.epochs),
            scale_m=scale_m,
            released=weights.get(f"mde_{name}", self.work / "none"),
            work=self.work,
        )
        sets = {"sim": self.parameters.cases, **({"real": self.parameters.real} if self.parameters.real else {})}
        constant = float(np.median(np.clip(subject.train_m / scale_m, 0, 1)))
        about: Row = {"model": name, "seed": int(seed), "stage": "s2s", "method": "s2s", "trials": 0}
        rows = [
            {**about, "set": where, "constant": constant, **row}
            for where, wanted in sets.items()
            for row in self._judged(s2s, name, wanted)
        ]
        if self.parameters.trials and self.parameters.real:
            trials = predicted_trials(self.place.data, self.parameters.trials, name, tuple(weights.items()))
            median = float(np.median(np.clip(trials.deviation_m / scale_m, 0, 1)))
            base = load_ensemble(s2s, model=name)
            for way in self.parameters.ways:
                folder = self.work / f"s2r_{name}-{way}-{seed}"
                release_finetuned(base, trials, folder, FinetuneSettings(method=way, seed=int(seed)))
                told = {"stage": "s2r", "method": way, "trials": len(trials), "set": "real", "constant": median}
                rows += [{**about, **told, **row} for row in self._judged(folder, name, self.parameters.real)]
        return rows

    def _judged(self, mde: Path, model: str, wanted: Cases) -> list[Row]:
        weights = tuple(self.place.weights(self.parameters.weights).items())
        true_m = true_deviations(self.place.data, wanted, model, weights)
        return judged(mde, model, find_cases(self.place.data, wanted), true_m)


def find_subject(dataset: Dataset, name: str, weights: Mapping[str, Path]) -> Subject:
    """Return a model with its deviations on a data set: cross-fitted ones where it was trained on it."""
    try:
        if name in weights:
            found = read_deviations(weights[name] / "deviations.npz", dataset)
            return Subject(name, found.version, found.train_m, found.test_m)
    except OtherSamplesError:
        pass
    return Subject.predicting(dataset, find_member(name, weights))
