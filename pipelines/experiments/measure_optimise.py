"""Optimisations of the cases' targets by several methods: a row for each method and target."""

from dataclasses import dataclass, replace
from functools import cache
from pathlib import Path

import numpy as np

from common.domain.case import Case
from pipelines.evaluate.family import make_kit, versions
from pipelines.evaluate.strategies import Comparison, Kit, run_strategies
from pipelines.evaluate.strategies_methods import parse_contender
from pipelines.experiments.case_sets import find_cases
from pipelines.experiments.finetunings import find_weights
from pipelines.experiments.parameters import Optimisations
from pipelines.experiments.place import Place, Report
from pipelines.experiments.raw import FILE, Row, collect


def measure_optimisations(parameters: Optimisations, folder: Path, place: Place, report: Report) -> None:
    """Optimise every target with every method; targets are worked on at the same time, each in one process."""
    cases = find_cases(place.data, parameters.cases)
    jobs = {str(index): len(parameters.methods) for index in range(len(cases))}
    about = {**parameters.about(), "cases": cases.about(), **versions(find_weights(parameters, place))}
    make_plan(parameters, len(cases))
    collect(folder / FILE, about, jobs, _Work(parameters, place), workers=place.workers, report=report)


def make_plan(parameters: Optimisations, targets: int) -> Comparison:
    """Return the comparison that the parameters describe, without execution errors.

    Raises:
        RequestError: There is no such method.
    """
    trusted = parameters.family[-1]
    methods = tuple(parse_contender(name, trusted=trusted) for name in parameters.methods)
    return Comparison(targets, parameters.seed, parameters.evaluations, methods, trusted, jitter=0)


@dataclass(frozen=True)
class _Work:
    """Optimises one target with all methods."""

    parameters: Optimisations
    place: Place

    def __call__(self, job: str) -> list[Row]:
        """Return the rows of a target."""
        cases = find_cases(self.place.data, self.parameters.cases)
        index, case = int(job), cases.case(int(job))
        weights = tuple(find_weights(self.parameters, self.place).items())
        kit = find_kit(self.parameters.family, weights)
        if self.parameters.resimulated:
            case = resimulated(case, kit)
        return list(run_strategies(case, index, make_plan(self.parameters, len(cases)), kit, set()))


@cache
def find_kit(family: tuple[str, ...], weights: tuple[tuple[str, Path], ...]) -> Kit:
    """Return models and MDEs of a family; they stay with the process."""
    return make_kit(family, dict(weights))


def resimulated(case: Case, kit: Kit) -> Case:
    """Return a case whose target is the trusted model's outcome of the true action."""
    with kit.meter.unpaid():
        found = kit.trusted.predict(case.state, np.array([case.true_action]))
    return replace(case, target=found.heights[0])
