"""The deviation of a model over all actions of a scene: true, by asking the simulator everywhere, and estimated."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from common.domain.deviation import DeviationEstimator, deviation
from common.domain.model import PredictiveModel
from common.domain.scene import State
from common.domain.task import Task


@dataclass(frozen=True)
class AcceptMap:
    """One model in one state, over a grid of actions; deviations are scaled to [0, 1].

    Attributes:
        model: The model.
        d_max: Threshold of its MDE.
        scene: Heightmap ``(H, W)`` [m].
        item: Thickness ``(H, W)`` [m].
        cell: Edge of a cell [m].
        x: Actions' x ``(n,)`` [m].
        y: Actions' y ``(n,)`` [m].
        truth: True deviations ``(n, n)``, rows along y.
        mean: Estimates ``(n, n)``.
        upper: Upper bounds ``(n, n)``.
    """

    model: str
    d_max: float
    scene: NDArray[np.float32]
    item: NDArray[np.float32]
    cell: float
    x: NDArray[np.float64]
    y: NDArray[np.float64]
    truth: NDArray[np.float64]
    mean: NDArray[np.float64]
    upper: NDArray[np.float64]


def accept_maps(
    state: State,
    task: Task,
    trusted: PredictiveModel,
    models: Mapping[str, PredictiveModel],
    estimators: Mapping[str, tuple[DeviationEstimator, float, float]],
    *,
    count: int,
    report: Callable[[int], None] = lambda done: None,
) -> tuple[AcceptMap, ...]:
    """Return a map for every model.

    Args:
        state: Scene and item.
        task: Whose bounds the actions fill.
        trusted: The simulator.
        models: The fast models by name.
        estimators: By name the MDE, its scale [m] and its d_max.
        count: Actions along each axis.
        report: Called with the number of simulated actions.
    """
    x, y = (np.linspace(low, high, count) for low, high in task.bounds(state))
    actions = np.stack(np.meshgrid(x, y), axis=-1).reshape(-1, 2)
    truth = {name: np.empty(len(actions)) for name in models}
    size = min(16, trusted.largest_batch, *(model.largest_batch for model in models.values()))
    for start in range(0, len(actions), size):
        part = actions[start : start + size]
        outcomes = trusted.predict(state, part).heights
        for name, model in models.items():
            truth[name][start : start + size] = deviation(model.predict(state, part).heights, outcomes)
        report(min(start + size, len(actions)))
    maps: list[AcceptMap] = []
    for name, (estimator, scale_m, d_max) in estimators.items():
        estimates = estimator.estimate(state, actions)
        square = (count, count)
        maps.append(
            AcceptMap(
                model=name,
                d_max=d_max,
                scene=state.scene.heights,
                item=state.item.heights,
                cell=state.grid.cell,
                x=x,
                y=y,
                truth=np.clip(truth[name] / scale_m, 0, 1).reshape(square),
                mean=estimates.mean.reshape(square),
                upper=estimates.upper.reshape(square),
            )
        )
    return tuple(maps)


def write_map(path: Path, drawn: AcceptMap) -> None:
    """Write a map as NPZ."""
    path.parent.mkdir(parents=True, exist_ok=True)
    np.savez_compressed(path, **vars(drawn))


def read_map(path: Path) -> AcceptMap:
    """Read what `write_map` wrote."""
    with np.load(path) as file:
        fields = {name: file[name] for name in AcceptMap.__dataclass_fields__}
    single = {"model": str(fields["model"]), "d_max": float(fields["d_max"]), "cell": float(fields["cell"])}
    return AcceptMap(**{**fields, **single})
