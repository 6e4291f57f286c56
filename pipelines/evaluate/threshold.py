"""All models with `threshold` against the simulator alone, on held-out targets: the raw results."""

import json
from collections.abc import Callable, Iterator, Mapping, Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import asdict, dataclass
from multiprocessing import get_context
from pathlib import Path
from typing import Any

import numpy as np

from common.domain.case import Case
from common.domain.deviation import DeviationEstimator
from common.domain.errors import RequestError
from common.domain.model import PredictiveModel
from common.domain.trial import Result
from common.planning.optimize import optimize
from common.planning.problem import Problem
from common.storage.results import action_error
from common.tasks import TASKS
from pipelines.json_lines import read_json_lines

TRUSTED = "simulator"


@dataclass(frozen=True)
class Method:
    """One way to optimise.

    Attributes:
        strategy: Name of the strategy.
        d_max: Threshold.
    """

    strategy: str
    d_max: float = 0.4

    @property
    def label(self) -> str:
        """Return a name that no other method has."""
        return f"{self.strategy} {self.d_max:g}" if self.strategy.startswith("threshold") else self.strategy


METHODS = (
    Method(f"only:{TRUSTED}"),
    Method("threshold", 0.2),
    Method("threshold", 0.3),
    Method("threshold", 0.4),
    Method("threshold:upper", 0.4),
    Method("only:learned"),
    Method("only:heuristic"),
)
"""What is compared by default."""


@dataclass(frozen=True)
class Equipment:
    """What optimises.

    Attributes:
        models: Models by name, from cheapest to dearest.
        estimators: MDEs by the name of their model.
    """

    models: Mapping[str, PredictiveModel]
    estimators: Mapping[str, DeviationEstimator]


@dataclass(frozen=True)
class Plan:
    """One experiment.

    Attributes:
        targets: Number of targets.
        seed: Seed of targets and optimisations.
        evaluations: Evaluations of an optimisation.
        methods: What is compared.
    """

    targets: int
    seed: int = 0
    evaluations: int = 50
    methods: tuple[Method, ...] = METHODS


def run_target(case: Case, index: int, plan: Plan, equipment: Equipment, done: set[str]) -> Iterator[dict[str, Any]]:
    """Optimise one target with every method that is not done, and yield a record of each.

    The reward of the chosen action is simulated where another model predicted it; that is not part of the time.
    """
    problem = Problem(TASKS["plating"], case.state, case.target)
    for method in plan.methods:
        if method.label in done:
            continue
        result = optimize(
            problem,
            equipment.models,
            equipment.estimators,
            strategy=method.strategy,
            d_max=method.d_max,
            evaluations=plan.evaluations,
            seed=plan.seed + index,
        )
        true_reward = simulated_reward(problem, result, equipment.models[TRUSTED])
        yield record(case, index, method, result, true_reward=true_reward)


def record(case: Case, index: int, method: Method, result: Result, *, true_reward: float | None) -> dict[str, Any]:
    """Return a result as it is kept, ready for JSON."""
    return {
        "target": index,
        "case": case.name,
        "same_item": case.same_item,
        "method": method.label,
        "action": list(result.action),
        "true_action": case.true_action,
        "action_error_m": action_error(result, case),
        "reward": result.reward,
        "true_reward": true_reward,
        "usage": result.usage,
        "wall_s": result.wall_s,
        "split_s": result.split_s,
        "seed": result.seed,
        "unfamiliar": sum(bool(trial.unfamiliar) for trial in result.trials),
        "trials": [asdict(trial) for trial in result.trials],
    }


def run(
    path: Path,
    plan: Plan,
    about: Mapping[str, Any],
    work: Callable[[int, set[str]], Sequence[dict[str, Any]]],
    *,
    workers: int = 1,
    report: Callable[[int], None] = lambda done: None,
) -> None:
    """Run an experiment and append each result to a file of JSON Lines; what is there already is not run again.

    Args:
        path: The file; its first line tells of the experiment.
        plan: The experiment.
        about: Versions and weights that the results rest on.
        work: Runs what is not done of a target, `run_target` with everything it needs; it is called in processes of
            their own where there are several workers, so it has to be pickled then.
        workers: Targets at the same time.
        report: Called with the number of targets that are done.

    Raises:
        RequestError: The file holds another experiment.
    """
    header = json.loads(
        json.dumps({"experiment": {**asdict(plan), "methods": [m.label for m in plan.methods], **about}})
    )
    done = _prepare(path, header)
    open_targets = [index for index in range(plan.targets) if len(done.get(index, ())) < len(plan.methods)]
    report(plan.targets - len(open_targets))
    with path.open("a") as file:

        def keep(records: Sequence[dict[str, Any]], finished: int) -> None:
            for one in records:
                file.write(json.dumps(one) + "\n")
            file.flush()
            report(plan.targets - len(open_targets) + finished)

        if workers == 1:
            for finished, index in enumerate(open_targets, start=1):
                keep(work(index, done.get(index, set())), finished)
            return
        with ProcessPoolExecutor(workers, mp_context=get_context("spawn")) as pool:
            futures = [pool.submit(work, index, done.get(index, set())) for index in open_targets]
            for finished, future in enumerate(futures, start=1):
                keep(future.result(), finished)


def read_records(path: Path) -> tuple[dict[str, Any], list[dict[str, Any]]]:
    """Return what the first line of a file tells of the experiment, and all records; a broken last line is left out.

    Raises:
        RequestError: It is no such file.
    """
    lines = read_json_lines(path)
    if not lines or "experiment" not in lines[0]:
        raise RequestError(f"{path}: expected an experiment in the first line, got {lines[:1]!r:.80}")
    return lines[0]["experiment"], lines[1:]


def _prepare(path: Path, header: dict[str, Any]) -> dict[int, set[str]]:
    """Return the methods that are done by target; drop a line that was broken by an interruption."""
    path.parent.mkdir(parents=True, exist_ok=True)
    done: dict[int, set[str]] = {}
    records: list[dict[str, Any]] = []
    if path.exists() and path.stat().st_size:
        experiment, records = read_records(path)
        if experiment != header["experiment"]:
            different = sorted(
                name
                for name in {*experiment, *header["experiment"]}
                if experiment.get(name) != header["experiment"].get(name)
            )
            raise RequestError(f"{path}: expected the same experiment, got another one: {', '.join(different)} differ")
    for one in records:
        done.setdefault(one["target"], set()).add(one["method"])
    unfinished = path.with_name(f".{path.name}.partial")
    unfinished.write_text("".join(json.dumps(line) + "\n" for line in (header, *records)))
    unfinished.replace(path)
    return done


def simulated_reward(problem: Problem, result: Result, simulator: PredictiveModel) -> float:
    """Return the reward of the answer as the simulator sees it [m]."""
    best = max(
        (trial for trial in result.trials if trial.reward is not None), key=lambda trial: trial.reward or -np.inf
    )
    if best.model == TRUSTED:
        return result.reward
    heights = simulator.predict(problem.state, np.array([result.action])).heights[0]
    return float(problem.task.reward(heights, problem.target))
