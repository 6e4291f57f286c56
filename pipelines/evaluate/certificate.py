"""Whether certificates hold: optimise a target, simulate every action that the certificate is about, compare."""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from common.domain.case import Case
from common.domain.model import PredictiveModel
from common.planning.certificate import (
    FACTORS,
    PROBABILITY,
    SMALLEST,
    conformal_quantile,
    needed_factor,
)
from common.planning.plan import Outcome, Setting
from common.planning.plan_transport import TransportPlan
from common.planning.problem import Problem
from common.planning.strategy_transport import QUICK
from common.planning.sweep import Sweeps
from common.tasks import TASKS
from pipelines.evaluate.threshold import TRUSTED, Equipment

METHOD = "certificate"


def run_certificate(case: Case, index: int, equipment: Equipment, *, calls: int) -> dict[str, Any]:
    """Optimise one target with `TransportPlan` without stopping early, then simulate the certificate's grid.

    The record has the best reward and the slack after every call, and all simulated rewards, so that other
    factors, probabilities and rules of stopping can be judged without simulating again.
    """
    problem, simulator = Problem(TASKS["plating"], case.state, case.target), equipment.models[TRUSTED]
    sweeps = Sweeps(problem, equipment.models, equipment.estimators, now=lambda: 0.0, wait_for=lambda ask: ask())
    names = tuple(equipment.models)
    plan = TransportPlan(
        Setting(problem, names, TRUSTED, calls, index, sweeps),
        calls=calls,
        hasty=calls <= QUICK,
        enough=0.0,
    )
    actions: list[list[float]] = []
    path: list[dict[str, Any]] = []
    while (action := plan.ask()) is not None:
        heights, reward = _simulate(problem, simulator, action)
        plan.tell(len(actions), Outcome(TRUSTED, reward, heights))
        actions.append(action.tolist())
        found = plan.certificate()
        slack = plan.slack()
        path.append(
            {
                "reward": reward,
                "slack_m": None if slack is None else slack[0],
                "left": None if slack is None else slack[1],
                "gain_m": None if found is None else found.gain,
            }
        )
    grid = plan.grid()
    rewards = [_simulate(problem, simulator, action)[1] for action in grid]
    return {
        "target": index,
        "method": METHOD,
        "case": case.name,
        "same_item": case.same_item,
        "model": plan.model,
        "actions": actions,
        "path": path,
        "grid": grid.tolist(),
        "grid_rewards": rewards,
    }


def _simulate(
    problem: Problem, simulator: PredictiveModel, action: NDArray[np.float64]
) -> tuple[NDArray[np.float32], float]:
    heights = simulator.predict(problem.state, action[None]).heights[0]
    return heights, float(problem.task.reward(heights, problem.target))


def certificate_table(records: Sequence[Mapping[str, Any]], budgets: Sequence[int]) -> dict[str, Any]:
    """Return what the records say, SI units: a row per budget, and the factors that these targets ask for.

    A row has the share of violated certificates, the median and mean of the stated gains, the median of the true ones,
    and for comparison the constant gain that would hold for the same share of these targets. Before the last call the
    true gain is measured against everything that was simulated in the end.
    ``anywhere`` is the share of targets where any of the certificates on the way was violated. ``factors`` are by model
    the conformal quantile of the factors that would have held all the way; infinity (None) where targets are too few.
    """
    certified = [record for record in records if record["path"] and record["path"][0]["slack_m"] is not None]
    needed: dict[str, list[float]] = {}
    for record in certified:
        gains = true_gains(record)
        scores = [
            needed_factor(gain, step["slack_m"], calls)
            for calls, (gain, step) in enumerate(zip(gains, record["path"], strict=True), start=1)
        ]
        needed.setdefault(record["model"], []).append(max(scores))
    factors = {model: conformal_quantile(scores) for model, scores in needed.items()}
    stated = [record for record in certified if record["model"] in FACTORS]
    return {
        "targets": len(records),
        "certified": len(stated),
        "probability": PROBABILITY,
        "factors_used": {model: FACTORS[model] for model in needed if model in FACTORS},
        "factors_needed": {model: value if np.isfinite(value) else None for model, value in factors.items()},
        "anywhere": _share([any(_violations(record)) for record in stated]),
        "rows": [_row(stated, calls) for calls in budgets] if stated else [],
    }


def true_gains(record: Mapping[str, Any]) -> NDArray[np.float64]:
    """Return how much better than the answer after each call the best simulated action is ``(calls,)`` [m]."""
    best = np.maximum.accumulate([step["reward"] for step in record["path"]])
    return np.maximum(max(best[-1], *record["grid_rewards"]) - best, 0.0)


def _violations(record: Mapping[str, Any]) -> list[bool]:
    return [bool(true > said) for true, said in zip(true_gains(record), _stated(record), strict=True)]


def _stated(record: Mapping[str, Any]) -> list[float]:
    factor = FACTORS[record["model"]]
    return [factor * max(step["slack_m"], SMALLEST) / calls for calls, step in enumerate(record["path"], start=1)]


def _row(records: Sequence[Mapping[str, Any]], calls: int) -> dict[str, Any]:
    last = [min(calls, len(record["path"])) - 1 for record in records]
    stated = np.array([_stated(record)[step] for record, step in zip(records, last, strict=True)])
    true = np.array([true_gains(record)[step] for record, step in zip(records, last, strict=True)])
    constant = conformal_quantile(true.tolist())
    return {
        "calls": calls,
        "violated": _share((true > stated).tolist()),
        "gain_median_m": float(np.median(stated)),
        "gain_mean_m": float(stated.mean()),
        "true_gain_median_m": float(np.median(true)),
        "constant_gain_m": constant if np.isfinite(constant) else None,
        "left": float(np.mean([record["path"][step]["left"] for record, step in zip(records, last, strict=True)])),
    }


def _share(found: Sequence[bool]) -> float | None:
    return float(np.mean(found)) if found else None
