"""What MDEs of several seeds say about test samples: a row for each model, seed and sample."""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from common.domain.deviation import deviation
from common.domain.model import PredictiveModel
from common.learning.weights import read_card
from common.storage.dataset import Dataset
from pipelines.evaluate.family import find_member, versions
from pipelines.evaluate.mdes_runs import find_weights
from pipelines.experiments.case_sets import CaseSet, find_cases
from pipelines.experiments.parameters import MdeErrors
from pipelines.experiments.place import Place, Report
from pipelines.experiments.raw import FILE, Row, collect
from pipelines.mde.crossfit import OtherSamplesError, read_deviations
from pipelines.mde.examples import deviation_scale
from pipelines.mde.subject import Subject
from pipelines.mde.train import default_settings
from services.mde.estimator import read_estimator

WEIGHTS = "weights"
"""Folder of trained weights beside the raw results."""


def measure_mdes(parameters: MdeErrors, folder: Path, place: Place, report: Report) -> None:
    """Train MDEs that are not there, on the training split, and ask each about every test sample."""
    cases = find_cases(place.data, parameters.cases)
    real = find_cases(place.data, parameters.real) if parameters.real else None
    rows = len(cases) + (len(real) if real else 0)
    jobs = {f"{model}/{seed}": rows for model in parameters.models for seed in parameters.seeds}
    sets = {"cases": cases.about(), "real": real and real.about()}
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
        weights, cases = self.place.weights(self.parameters.weights), find_cases(self.place.data, self.parameters.cases)
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
        model, sets = find_member(name, weights), {"sim": cases}
        if self.parameters.real:
            sets["real"] = find_cases(self.place.data, self.parameters.real)
        constant = float(np.median(np.clip(subject.train_m / scale_m, 0, 1)))
        about: Row = {"model": name, "seed": int(seed), "stage": "s2s", "method": "s2s", "trials": 0}
        return [
            {**about, "set": where, "constant": constant, **row}
            for where, judged in sets.items()
            for row in judge_cases(s2s, model, judged)
        ]


def find_subject(dataset: Dataset, name: str, weights: Mapping[str, Path]) -> Subject:
    """Return a model with its deviations on a data set: cross-fitted ones where it was trained on it."""
    try:
        if name in weights:
            found = read_deviations(weights[name] / "deviations.npz", dataset)
            return Subject(name, found.version, found.train_m, found.test_m)
    except OtherSamplesError:
        pass
    return Subject.predicting(dataset, find_member(name, weights))


def judge_cases(weights: Path, model: PredictiveModel, cases: CaseSet) -> Iterator[Row]:
    """Yield what the MDE in a folder says about every case, beside the model's true deviation."""
    estimator, card = read_estimator(weights, model=model.name, threads=1), read_card(weights)
    scale_m = card.deviation_scale_m or np.nan
    for index in range(len(cases)):
        case = cases.case(index)
        action = np.array([case.true_action])
        true_m = deviation(model.predict(case.state, action).heights[0], case.target)
        found = estimator.estimate(case.state, action)
        yield {
            "sample": index,
            "group": int(cases.groups[index]),
            "truth": float(np.clip(true_m / scale_m, 0, 1)),
            "mean": float(found.mean[0]),
            "upper": float(found.upper[0]),
            "familiar": bool(found.familiar[0]),
            "sha256": card.sha256,
        }
