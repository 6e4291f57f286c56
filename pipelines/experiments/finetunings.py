"""MDEs that are fine-tuned on trials, for measurements."""

import hashlib
from functools import cache
from pathlib import Path

import numpy as np

from common.domain.deviation import deviation
from common.domain.errors import ModelError
from common.learning.weights import read_card
from pipelines.evaluate.family import find_member
from pipelines.experiments.case_sets import CaseSet, find_cases
from pipelines.experiments.parameters import Cases, OnCases
from pipelines.experiments.place import Place
from pipelines.experiments.raw import Row
from pipelines.mde.finetune import FinetuneSettings, release_finetuned
from pipelines.mde.trials import Trials
from services.mde.ensemble import load_ensemble
from services.mde.estimator import read_estimator

Weights = tuple[tuple[str, Path], ...]
"""Folders of weights by the name of whose they are, as something that a cache takes."""


def find_weights(parameters: OnCases, place: Place) -> dict[str, Path]:
    """Return the folders of weights that a measurement is made with; MDEs are fine-tuned first where it says so."""
    weights = place.weights(parameters.weights)
    wanted = parameters.finetuned
    if wanted is None:
        return weights
    key = f"{wanted.model_dump_json()}{sorted(parameters.weights.items())}"
    work = place.raw / f"finetuned-{hashlib.sha256(key.encode()).hexdigest()[:10]}"
    for name, folder in sorted(wanted.bases.items()):
        settings = FinetuneSettings(method=wanted.method, seed=wanted.seed)
        weights[name] = finetune_once(
            place, name.removeprefix("mde_"), wanted.trials, place.models / folder, work / name, settings, weights
        )
    return weights


def finetune_once(
    place: Place,
    model: str,
    trials: Cases,
    base: Path,
    folder: Path,
    settings: FinetuneSettings,
    weights: dict[str, Path],
) -> Path:
    """Return the folder of an MDE that is fine-tuned on all trials of a folder, made where it is not there.

    What is there is made again where the base or the trials are others.
    """
    found = predicted_trials(place.data, trials, model, tuple(weights.items()))
    try:
        card = read_card(folder)
        if card.dataset.version == found.digest[:16] and (
            card.settings["finetuning"]["base"]["sha256"] == read_card(base).sha256
        ):
            return folder
    except (ModelError, KeyError):
        pass
    release_finetuned(load_ensemble(base, model=model), found, folder, settings)
    return folder


@cache
def predicted_trials(data: Path, wanted: Cases, model: str, weights: Weights) -> Trials:
    """Return trials with how far a model was from them; they stay with the process."""
    cases = find_cases(data, wanted)
    chosen = [cases.case(index) for index in range(len(cases))]
    return Trials.predicted(", ".join(wanted.trials), chosen, find_member(model, dict(weights)))


@cache
def true_deviations(data: Path, wanted: Cases, model: str, weights: Weights) -> tuple[float, ...]:
    """Return how far a model is from the outcome of every case [m]; it stays with the process."""
    cases, found = find_cases(data, wanted), find_member(model, dict(weights))
    values: list[float] = []
    for index in range(len(cases)):
        case = cases.case(index)
        heights = found.predict(case.state, np.array([case.true_action])).heights[0]
        values.append(float(deviation(heights, case.target)))
    return tuple(values)


def judged(folder: Path, model: str, cases: CaseSet, deviations_m: tuple[float, ...]) -> list[Row]:
    """Return what the MDE in a folder says about every case, beside the true deviation."""
    estimator, card = read_estimator(folder, model=model, threads=1), read_card(folder)
    scale_m = card.deviation_scale_m or float("nan")
    rows: list[Row] = []
    for index in range(len(cases)):
        case = cases.case(index)
        found = estimator.estimate(case.state, np.array([case.true_action]))
        rows.append(
            {
                "sample": index,
                "group": int(cases.groups[index]),
                "truth": float(np.clip(deviations_m[index] / scale_m, 0, 1)),
                "mean": float(found.mean[0]),
                "upper": float(found.upper[0]),
                "familiar": bool(found.familiar[0]),
                "sha256": card.sha256,
            }
        )
    return rows
