"""Work on states with live simulator workers on Zenoh; only the fries are settled on this machine."""

import time
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from dataclasses import dataclass
from functools import partial

import numpy as np
from numpy.typing import NDArray

from common.domain.bodies import Box, Plate
from common.domain.errors import BusyError, RequestError, TimedOutError, UnavailableError
from common.domain.grid import Floats
from common.domain.model import Predictions, PredictiveModel
from common.domain.scene import State
from common.storage.dataset_card import DatasetPlan
from common.wire.directory import Directory
from common.wire.dispatch import Limits
from common.wire.remote import RemoteModel
from common.wire.session import Session
from pipelines.data.generate import Submit
from pipelines.data.local import local_processes
from pipelines.data.sample import make_state

TIMEOUT_S = 120.0
PATIENCE_S = 60.0
PAUSE_S = 0.5
MOST_THREADS = 256


@dataclass(frozen=True)
class RemoteWorkers:
    """Starts the work on a state, and tells how many states should be at work now."""

    submit: Submit
    in_flight: Callable[[], int]


@contextmanager
def remote_workers(plan: DatasetPlan, session: Session, *, task: str, settlers: int) -> Iterator[RemoteWorkers]:
    """Let all live workers of the plan's model simulate, those that join later too.

    Args:
        plan: What the data set is made from.
        session: A client session.
        task: The workers' task.
        settlers: Processes of this machine that let fries come to rest.

    Raises:
        RequestError: The workers run another version than the plan says.
        UnavailableError: There is no worker, or there has been none for `PATIENCE_S`.
    """
    directory = Directory(session, task=task)
    ending = False
    try:
        limits = Limits(timeout_s=TIMEOUT_S, cancelled=lambda: ending)
        remote = RemoteModel(directory, plan.model, limits=limits)
        if remote.version != plan.version:
            raise RequestError(f"expected workers of {plan.model} {plan.version}, got {remote.version}")
        with local_processes(settlers) as processes, ThreadPoolExecutor(MOST_THREADS) as threads:

            def settle(plate: Plate, boxes: Sequence[Box]) -> tuple[Box, ...]:
                return processes.submit(_settle, plate, tuple(boxes)).result()

            make = partial(make_state, settle=settle, model=PatientModel(remote, patience_s=PATIENCE_S))
            try:
                yield RemoteWorkers(
                    lambda split, index: threads.submit(make, plan, split, index),
                    lambda: min(2 * settlers + 2 * len(directory.workers("model", plan.model)), MOST_THREADS),
                )
            finally:
                ending = True
                threads.shutdown(wait=True, cancel_futures=True)
    finally:
        directory.close()


class PatientModel(PredictiveModel):
    """A model that asks again while nobody serves it, as when a router is restarted.

    Args:
        model: Whom to ask.
        patience_s: How long [s].
    """

    def __init__(self, model: PredictiveModel, *, patience_s: float) -> None:
        self.name, self.version, self.largest_batch = model.name, model.version, model.largest_batch
        self._model = model
        self._patience_s = patience_s

    def outcomes(self, state: State, actions: NDArray[np.float64]) -> tuple[Floats, tuple[str, ...]]:
        """Return the model's heightmaps ``(B, H, W)`` [m] and warnings."""
        predictions = self.predict(state, actions)
        return predictions.heights, predictions.warnings

    def predict(self, state: State, actions: Floats) -> Predictions:
        """Return the model's predictions, once somebody serves it."""
        alone_since: float | None = None
        while True:
            try:
                return self._model.predict(state, actions)
            except (UnavailableError, TimedOutError) as error:
                now = time.monotonic()
                alone_since = None if isinstance(error, BusyError) else alone_since or now
                if alone_since is not None and now - alone_since > self._patience_s:
                    raise
                time.sleep(PAUSE_S)


def _settle(plate: Plate, boxes: tuple[Box, ...]) -> tuple[Box, ...]:
    from services.simulator.settle import settle_boxes

    return settle_boxes(plate, boxes)
