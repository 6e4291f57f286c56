"""The raw results behind Table I: each model's distance from the trusted outcome on test samples, and its times."""

import json
import os
from collections.abc import Callable, Iterable, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from time import perf_counter

import numpy as np
from numpy.typing import NDArray

from common.domain.model import PredictiveModel
from common.storage.dataset import Dataset, Samples
from pipelines.evaluate.regions import region
from pipelines.predictions import Done, predict_samples, rmse

BATCH = 8
"""Actions in the batches of the fast models that are timed."""


@dataclass(frozen=True)
class Measurement:
    """One model on one test sample.

    Attributes:
        model: Its name.
        version: Its version.
        reference: What its outcome is compared with: ``data``, or the name of a model.
        sample: Number of the sample among the test samples.
        group: Number of its state.
        region: What lies below the item, see `regions`.
        rigid: Whether the item is one rigid body.
        rmse_m: Root mean squared height difference over the grid [m].
        time_s: Time of the prediction where it was measured on its own [s].
    """

    model: str
    version: str
    reference: str
    sample: int
    group: int
    region: str
    rigid: bool
    rmse_m: float
    time_s: float | None = None


@dataclass(frozen=True)
class Latency:
    """Times of one model for a prediction, in batches [s]."""

    model: str
    batch: int
    times_s: tuple[float, ...]


def measure(
    model: PredictiveModel, dataset: Dataset, samples: Samples, *, report: Done = lambda done: None
) -> tuple[Measurement, ...]:
    """Compare a model's predictions with the outcomes of all test samples."""
    everything = np.arange(len(samples))
    predicted = predict_samples(model, dataset, "test", samples, everything, report=report)
    errors = rmse(predicted, samples.outcomes)
    return tuple(_row(model, "data", dataset, samples, index, float(errors[index])) for index in range(len(samples)))


def measure_pair(
    model: PredictiveModel,
    reference: PredictiveModel,
    dataset: Dataset,
    samples: Samples,
    *,
    count: int,
    report: Done = lambda done: None,
) -> tuple[Measurement, ...]:
    """Compare two models on about ``count`` test samples evenly spread, and time the first one on each.

    Its state is new to it once; what is computed once for a state is not in the times.
    """
    rows: list[Measurement] = []
    spread = np.unique(np.linspace(0, len(samples) - 1, count).round().astype(int))
    for done, index in enumerate(spread.tolist(), start=1):
        state, action = dataset.state("test", int(samples.groups[index])), samples.actions[index : index + 1]
        model.predict(state, action)
        began = perf_counter()
        predicted = model.predict(state, action).heights
        time_s = perf_counter() - began
        error = rmse(predicted, reference.predict(state, action).heights)
        rows.append(_row(model, reference.name, dataset, samples, index, float(error[0]), time_s))
        report(done)
    return tuple(rows)


def time_batches(
    model: PredictiveModel, dataset: Dataset, samples: Samples, *, states: int, report: Done = lambda done: None
) -> Latency:
    """Time batches of `BATCH` actions in test states that the model has seen once."""
    groups = np.unique(samples.groups)[:states]
    times: list[float] = []
    for done, group in enumerate(groups, start=1):
        state = dataset.state("test", int(group))
        actions = samples.actions[np.arange(group, group + BATCH) % len(samples)]
        model.predict(state, actions[:1])
        began = perf_counter()
        model.predict(state, actions)
        times.append((perf_counter() - began) / BATCH)
        report(done)
    return Latency(model.name, BATCH, tuple(times))


def write_rows(path: Path, rows: Iterable[Measurement | Latency]) -> None:
    """Write raw results as JSON Lines; the file appears whole or not at all."""
    path.parent.mkdir(parents=True, exist_ok=True)
    unfinished = path.with_name(f".{path.name}.{os.getpid()}")
    unfinished.write_text("".join(json.dumps({type(row).__name__: asdict(row)}) + "\n" for row in rows))
    unfinished.replace(path)


def read_rows(path: Path) -> tuple[Measurement | Latency, ...]:
    """Read what `write_rows` wrote."""
    kinds: dict[str, Callable[..., Measurement | Latency]] = {"Measurement": Measurement, "Latency": _latency}
    return tuple(
        kinds[kind](**fields) for line in path.read_text().splitlines() for kind, fields in json.loads(line).items()
    )


def _row(
    model: PredictiveModel,
    reference: str,
    dataset: Dataset,
    samples: Samples,
    index: int,
    error: float,
    time_s: float | None = None,
) -> Measurement:
    return Measurement(
        model=model.name,
        version=model.version,
        reference=reference,
        sample=int(index),
        group=int(samples.groups[index]),
        region=_region(dataset, samples, index),
        rigid=bool(samples.rigid[index]),
        rmse_m=error,
        time_s=time_s,
    )


def _region(dataset: Dataset, samples: Samples, index: int) -> str:
    action: NDArray[np.float64] = samples.actions[index]
    grid = dataset.card.grid.grid()
    return region(grid, samples.scene_materials[index], samples.item_heights[index], action)


def _latency(model: str, batch: int, times_s: Sequence[float]) -> Latency:
    return Latency(model, batch, tuple(times_s))
