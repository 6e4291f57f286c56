"""Made-up raw results of every kind."""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from pipelines.experiments.arrays import pack
from pipelines.experiments.experiment import Experiment
from pipelines.experiments.raw import Raw, Row

METHODS = {"only:heuristic": 3.0, "only:learned": 2.0, "only:simulator": 1.0, "only:simulator_fine": 1.0}
"""Method -> action error of its first target [mm]; of any other method, 1.5."""
MODELS = ("heuristic", "learned", "simulator", "simulator_fine")


def raw(rows: Sequence[Row], *, parameters: Any = None, seeds: Sequence[int] = (0,)) -> Raw:
    """Return raw results with a header."""
    about = parameters.about() if parameters is not None else {"parameters": {}, "seeds": list(seeds)}
    weights = {"learned": ["1", "ab12cd34ef"]}
    return Raw({**about, "weights": weights, "rows": len(rows)}, [{"job": "0", **row} for row in rows])


def results(experiment: Experiment) -> Mapping[str, Raw]:
    """Return made-up raw results of every measurement of an experiment."""
    makers = {
        "models": model_rows,
        "optimise": optimisation_rows,
        "examples": example_rows,
        "mdes": mde_rows,
        "sample_size": lambda parameters: curve_rows(parameters, parameters.methods),
        "active": lambda parameters: curve_rows(parameters, parameters.acquisitions),
    }
    return {
        name: raw(makers[parameters.kind](parameters), parameters=parameters)
        for name, parameters in experiment.measurements.items()
    }


def model_rows(parameters: Any) -> list[Row]:
    """Return four samples in two states of each model; the error of model m at sample i is (3 - m) (i + 1) mm."""
    return [
        {
            "model": model,
            "reference": "outcome",
            "sample": sample,
            "group": sample // 2,
            "rigid": sample % 2 == 0,
            "rmse_m": 1e-3 * (3 - place) * (sample + 1),
            "time_s": 1e-3 * (place + 1),
        }
        for place, model in enumerate(parameters.models)
        for sample in range(4)
    ]


def optimisation_rows(parameters: Any) -> list[Row]:
    """Return five targets by each method; errors and times grow with the target."""
    return [optimisation_row(method, target) for method in parameters.methods for target in range(5)]


def optimisation_row(method: str, target: int) -> Row:
    """Return what a method did with a target: six actions, three by the heuristic if it may choose."""
    alone = method.removeprefix("only:")
    models = [alone] * 6 if alone in MODELS else ["heuristic"] * 3 + ["learned", "simulator", "simulator"]
    error = METHODS.get(method, 1.5) * (1 + target)
    return {
        "target": target,
        "case": f"case-{target}",
        "same_item": True,
        "method": method,
        "seed": target,
        "action": [0.001 * error, 0.0],
        "true_action": [0.0, 0.0],
        "action_error_m": 1e-3 * error,
        "wall_s": 2.0 + target if alone == "simulator" else 1.0,
        "process_s": 0.5,
        "calls": models.count("simulator"),
        "usage": {model: models.count(model) + 10 * (method == "quality") for model in dict.fromkeys(models)},
        "trials": [a_trial(index, model) for index, model in enumerate(models)],
    }


def a_trial(index: int, model: str) -> Row:
    """Return an evaluated action."""
    action = [0.01 * index - 0.02, 0.01]
    about = {"instance": "local", "version": "1", "error": ""}
    return {"index": index, "action": action, "model": model, "reward": -1e-3, **about}


def example_rows(parameters: Any) -> list[Row]:
    """Return an example for each region."""
    scene = np.zeros((8, 10), dtype=np.float32)
    item = scene.copy()
    item[3:5, 4:7] = 0.01
    heights = {"scene": scene, "item": item, "target": scene + item, "achieved": scene + item}
    return [
        {
            **optimisation_row(parameters.method, place),
            "region": region,
            "cell": 0.01,
            **{name: pack(values) for name, values in heights.items()},
        }
        for place, region in enumerate(parameters.regions)
    ]


def mde_rows(parameters: Any) -> list[Row]:
    """Return judgements of both models, before and after fine-tuning."""
    rows: list[Row] = []
    for model, error in (("heuristic", 0.1), ("learned", 0.2)):
        rows += judgements(model, error=error, seeds=parameters.seeds, stage="s2s", place="sim", method="s2s")
        rows += judgements(model, error=2 * error, seeds=parameters.seeds, stage="s2s", place="real", method="s2s")
        for method in ("last", "full"):
            rows += judgements(model, error=error, seeds=parameters.seeds, stage="s2r", place="real", method=method)
    return rows


def curve_rows(parameters: Any, ways: Sequence[str]) -> list[Row]:
    """Return judgements whose error falls with the number of trials, faster for each way, and of no trial."""
    rows = judgements("learned", error=0.5, seeds=parameters.seeds, method="s2s", stage="s2s", trials=0)
    for place, way in enumerate(ways):
        for trials in parameters.counts:
            error = 0.4 / (1 + (1 + place) * trials / 20)
            rows += judgements("learned", error=error, seeds=parameters.seeds, method=way, trials=trials)
    return rows


def judgements(
    model: str,
    *,
    error: float,
    seeds: Sequence[int] = (0, 1, 2),
    stage: str = "s2r",
    place: str = "real",
    method: str = "last",
    trials: int = 80,
    samples: int = 6,
) -> list[Row]:
    """Return judgements that are off by ``error``, and by a hundredth more for each seed."""
    return [
        {
            "model": model,
            "seed": seed,
            "stage": stage,
            "set": place,
            "method": method,
            "trials": trials,
            "sample": sample,
            "group": sample // 2,
            "truth": 0.3 + 0.1 * (sample % 2),
            "mean": 0.3 + 0.1 * (sample % 2) + error + 0.01 * seed,
            "constant": 0.3,
        }
        for seed in seeds
        for sample in range(samples)
    ]
