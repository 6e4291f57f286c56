"""Make one state of a data set and its samples: a pure function of the plan, the split and the state's number."""

import time

import numpy as np
from numpy.typing import NDArray

from common.domain.errors import ModelError, RequestError, UnavailableError
from common.domain.model import PredictiveModel
from common.domain.scene import State
from common.storage.dataset_card import SPLITS, DatasetPlan, Split
from common.storage.dataset_record import StateSamples
from common.tasks.plating_sampler import Settler
from pipelines.data.presets import draw_action, draw_layout, draw_state


def make_state(plan: DatasetPlan, split: Split, index: int, *, settle: Settler, model: PredictiveModel) -> StateSamples:
    """Draw a state and its actions, and simulate them.

    What the model refuses, or does not bring to rest, is a failed sample and keeps its reason.

    Args:
        plan: What the data set is made from.
        split: ``train`` or ``test``.
        index: Number of the state.
        settle: Lets fries fall and come to rest.
        model: The trusted model.

    Raises:
        UnavailableError: Nobody serves the model, or one of its workers has another version.
    """
    began = time.perf_counter()
    seed = (plan.seed, SPLITS.index(split), index)
    grid, count = plan.grid.grid(), plan.actions_per_state
    actions = np.full((count, 2), np.nan)
    outcomes = np.full((count, *grid.shape), np.nan, dtype=np.float32)
    rng = np.random.default_rng(seed)
    layout = draw_layout(rng)
    try:
        drawn = draw_state(rng, grid, preset=plan.preset, layout=layout, settle=settle)
    except ModelError as error:
        wall = (time.perf_counter() - began,)
        return StateSamples(index, seed, layout, "", (), None, actions, outcomes, (), wall, f"state: {error}")
    wall_s, places, warnings = [time.perf_counter() - began], [], []
    for number in range(count):
        began = time.perf_counter()
        place, actions[number] = draw_action(rng, drawn.state)
        outcomes[number], warning = _simulate(model, drawn.state, actions[number])
        places.append(place)
        warnings.append(warning)
        wall_s.append(time.perf_counter() - began)
    return StateSamples(
        index, seed, layout, drawn.kind, tuple(places), drawn.state, actions, outcomes, tuple(warnings), tuple(wall_s)
    )


def _simulate(model: PredictiveModel, state: State, action: NDArray[np.float64]) -> tuple[NDArray[np.float32], str]:
    try:
        prediction = model.predict(state, action[None])
    except (ModelError, RequestError) as error:
        return np.full(state.grid.shape, np.nan, dtype=np.float32), f"{error.code}: {error}"
    if prediction.version != model.version:
        raise UnavailableError(
            f"expected {model.name} {model.version} for the whole data set, got {prediction.version} "
            f"from {prediction.instance}"
        )
    return prediction.heights[0], prediction.warnings[0]
