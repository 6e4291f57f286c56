"""``frugal finetune next``."""

import json
from pathlib import Path
from typing import Literal

import click
import numpy as np
from numpy.typing import NDArray

from common.domain.errors import RequestError
from common.domain.scene import State
from common.tasks import TASKS
from services.cli.asking import find_case
from services.cli.finetune_mde import BASE, MODEL, SEED, WEIGHTS, find_base, find_model, predict_trials

STEPS_MET = 9
"""Actions along x and y in each state of the reference."""


@click.command(name="next")
@MODEL
@click.option("--scene", required=True, help="The scene to try an action in: a case file, or a bundled scene's name.")
@click.option(
    "--trials",
    "folder",
    type=click.Path(path_type=Path),
    help="Folder of the trials' case files so far [default: none yet].",
)
@click.option(
    "--acquisition",
    type=click.Choice(["representative", "random", "lcb", "variance", "integrated"]),
    default="representative",
    show_default=True,
    help="Try what looks, with the trials so far, most like the actions of --reference (representative), where a trial "
    "tells most about them (integrated), where least is known (variance), or where the model may well be applicable "
    "(lcb).",
)
@click.option("--count", type=click.IntRange(1, 100), default=1, show_default=True, help="How many actions to propose.")
@click.option("--steps", type=click.IntRange(2, 64), default=17, show_default=True, help="Candidates along x and y.")
@click.option(
    "--reference",
    type=click.Path(path_type=Path),
    help="Folder of cases with states that the robot will meet [default: the scene alone].",
)
@SEED
@BASE
@WEIGHTS
@click.option("--json", "as_json", is_flag=True, help="Actions with what is expected of them as JSON.")
def next_actions(
    *,
    model: str,
    scene: str,
    folder: Path | None,
    acquisition: Literal["representative", "random", "lcb", "variance", "integrated"],
    count: int,
    steps: int,
    reference: Path | None,
    seed: int,
    base: Path | None,
    weights: Path | None,
    as_json: bool,
) -> None:
    """Propose the next actions to try in SCENE, on a grid over the task's bounds, in the order of trying them.

    Prints x and y in metres, one action a line.
    """
    from common.storage.cases import read_cases
    from pipelines.mde.active import belief_of, choose_next, points_of
    from pipelines.mde.active_representative import choose_representative
    from pipelines.mde.finetune import examples_of

    found, case = find_model(model, weights), find_case(scene)
    start = find_base(found.name, base)
    if case.state.grid != start.familiarity.grid:
        raise RequestError(f"scene: expected {start.familiarity.grid} as of {start.card.name}, got {case.state.grid}")
    pairs, deviations = [], np.empty(0)
    if folder is not None:
        trials = predict_trials(folder, found)
        pairs, deviations = trials.pairs(), examples_of(start, trials).deviations
    met = () if reference is None else [on_grid(one.state, STEPS_MET) for one in read_cases(reference)]
    actions = on_grid(case.state, steps)[1]
    belief = belief_of(
        start,
        found.name,
        trials=pairs,
        deviations=deviations,
        candidates=[(case.state, actions)],
        reference=met,
    )
    if acquisition == "representative":
        tried, candidates = (points_of(start, found.name, one).described for one in (pairs, [(case.state, actions)]))
        described = points_of(start, found.name, met).described if met else candidates
        chosen = choose_representative(described, tried, candidates, count=count)
    else:
        chosen = choose_next(belief, acquisition, count=count, seed=seed)
    if as_json:
        told = [
            {
                "action": actions[index].tolist(),
                "mean": float(belief.mean[index]),
                "sigma": float(np.sqrt(belief.variance[index])),
            }
            for index in chosen
        ]
        click.echo(json.dumps(told, indent=2))
        return
    for index in chosen:
        click.echo(" ".join(f"{value:.6f}" for value in actions[index]))


def on_grid(state: State, steps: int) -> tuple[State, NDArray[np.float64]]:
    """Return a state with actions on a grid over the task's bounds ``(steps^2, 2)`` [m]."""
    (x, y) = (np.linspace(low, high, steps) for low, high in TASKS["plating"].bounds(state))
    return state, np.stack(np.meshgrid(x, y), axis=-1).reshape(-1, 2)
