"""How far models are from the outcomes of cases: a row for each model and case."""

from dataclasses import dataclass
from functools import cache
from pathlib import Path
from time import perf_counter

import numpy as np

from common.domain.model import PredictiveModel
from pipelines.evaluate.family import find_member, versions
from pipelines.evaluate.regions import region
from pipelines.experiments.case_sets import find_cases
from pipelines.experiments.parameters import ModelErrors
from pipelines.experiments.place import Place, Report
from pipelines.experiments.raw import FILE, Row, collect
from pipelines.predictions import rmse


def measure_models(parameters: ModelErrors, folder: Path, place: Place, report: Report) -> None:
    """Measure models on cases, one after the other, so that their times are of one core."""
    cases, jobs = find_cases(place.data, parameters.cases), dict[str, int]()
    for model in parameters.models:
        against = parameters.against.get(model)
        count = len(cases) if against is None else min(against.count, len(cases))
        spread = np.linspace(0, len(cases) - 1, count).round().astype(int)
        jobs |= {f"{model}/{index}": 1 for index in spread.tolist()}
    weights = place.weights(parameters.weights)
    about = {**parameters.about(), "cases": cases.about(), **versions(weights)}
    collect(folder / FILE, about, jobs, _Work(parameters, place), report=report)


@dataclass(frozen=True)
class _Work:
    """Predicts one case with one model."""

    parameters: ModelErrors
    place: Place

    def __call__(self, job: str) -> list[Row]:
        """Return the row of a job ``<model>/<case>``."""
        name, index = job.split("/")
        cases = find_cases(self.place.data, self.parameters.cases)
        case, group = cases.case(int(index)), int(cases.groups[int(index)])
        model = _model(name, self.place, self.parameters)
        action, item = np.array([case.true_action]), case.state.item
        model.predict(case.state, action)  # what is done once for a state is not in the times
        began = perf_counter()
        predicted = model.predict(case.state, action)
        time_s, against = perf_counter() - began, self.parameters.against.get(name)
        outcome = case.target
        if against is not None:
            outcome = _model(against.model, self.place, self.parameters).predict(case.state, action).heights[0]
        row: Row = {
            "model": name,
            "version": model.version,
            "reference": "outcome" if against is None else against.model,
            "sample": int(index),
            "group": group,
            "case": case.name,
            "region": region(case.state.grid, case.state.scene.materials, item.heights, action[0]),
            "rigid": bool(item.is_rigid),
            "rmse_m": float(rmse(predicted.heights, outcome[None])[0]),
            "warning": predicted.warnings[0],
            "time_s": time_s,
        }
        return [row]


@cache
def _find(name: str, weights: tuple[tuple[str, Path], ...]) -> PredictiveModel:
    return find_member(name, dict(weights))


def _model(name: str, place: Place, parameters: ModelErrors) -> PredictiveModel:
    return _find(name, tuple(place.weights(parameters.weights).items()))
