"""Optimisations that are drawn: a row for each, with its scene, target and what its answer leads to."""

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from common.domain.case import Case
from common.domain.errors import RequestError
from pipelines.data.real import execute, look
from pipelines.evaluate.family import versions
from pipelines.evaluate.regions import region
from pipelines.evaluate.strategies import Comparison, run_strategies
from pipelines.evaluate.strategies_methods import parse_contender
from pipelines.experiments.arrays import pack
from pipelines.experiments.case_sets import CaseSet, find_cases
from pipelines.experiments.finetunings import find_weights
from pipelines.experiments.measure_optimise import find_kit
from pipelines.experiments.parameters import Examples
from pipelines.experiments.place import Place, Report
from pipelines.experiments.raw import FILE, Row, collect


def measure_examples(parameters: Examples, folder: Path, place: Place, report: Report) -> None:
    """Optimise the first target of each region, and let the trusted model place the item at the answer."""
    cases = find_cases(place.data, parameters.cases)
    jobs = {str(index): 1 for index in first_of_regions(cases, parameters.regions)}
    about = {**parameters.about(), "cases": cases.about(), **versions(find_weights(parameters, place))}
    collect(folder / FILE, about, jobs, _Work(parameters, place), workers=place.workers, report=report)


def first_of_regions(cases: CaseSet, regions: tuple[str, ...]) -> list[int]:
    """Return the number of the first case that each region has and no earlier one took.

    Raises:
        RequestError: A region has none.
    """
    found: list[int] = []
    of_cases = [case_region(cases.case(index)) for index in range(len(cases))]
    for name in regions:
        left = [index for index, of_case in enumerate(of_cases) if of_case == name and index not in found]
        if not left:
            raise RequestError(f"regions: expected a target of the region {name}, got none among {len(cases)}")
        found.append(left[0])
    return found


def case_region(case: Case) -> str:
    """Return what lies below the item where the true action puts it."""
    state = case.state
    return region(state.grid, state.scene.materials, state.item.heights, np.array(case.true_action))


def executed(case: Case, action: tuple[float, float]) -> NDArray[np.float32]:
    """Return what the robot would see after an action on the table of a trial ``(H, W)`` [m]: its seed names the table.

    No method sees this; it is only drawn.

    Raises:
        RequestError: The table looks otherwise than in the trial.
    """
    perceived, _ = look(case.seed, grid=case.state.grid)
    if perceived.state.digest != case.state.digest:
        raise RequestError(f"{case.name}: expected table {case.seed} of the world's stand-in, got another state")
    return execute(case.seed, perceived, action)


@dataclass(frozen=True)
class _Work:
    """Optimises one target."""

    parameters: Examples
    place: Place

    def __call__(self, job: str) -> list[Row]:
        """Return the row of a target.

        Raises:
            RequestError: The optimisation has failed.
        """
        parameters, index = self.parameters, int(job)
        case = find_cases(self.place.data, parameters.cases).case(index)
        kit = find_kit(parameters.family, tuple(find_weights(parameters, self.place).items()))
        trusted = parameters.family[-1]
        method = parse_contender(parameters.method, trusted=trusted)
        plan = Comparison(index + 1, parameters.seed, parameters.evaluations, (method,), trusted, jitter=0)
        (row,) = run_strategies(case, index, plan, kit, set())
        if "error" in row:
            raise RequestError(f"{case.name}: expected an answer of {parameters.method}, got {row['error']}")
        action = (row["action"][0], row["action"][1])
        achieved = (
            executed(case, action)
            if parameters.executed
            else kit.trusted.predict(case.state, np.array([action])).heights[0]
        )
        state = case.state
        heights = {"scene": state.scene.heights, "item": state.item.heights, "target": case.target}
        return [
            {
                **row,
                "region": case_region(case),
                "cell": state.grid.cell,
                **{name: pack(values) for name, values in {**heights, "achieved": achieved}.items()},
            }
        ]
