"""Several simulators that run at the same time, each in a process of its own."""

import queue
import time
from collections.abc import Callable
from concurrent.futures import ProcessPoolExecutor
from multiprocessing import get_context
from threading import Lock

import numpy as np
from numpy.typing import NDArray

from common.domain.grid import Floats
from common.domain.model import Predictions, PredictiveModel
from common.domain.scene import State

Make = Callable[[], PredictiveModel]

_loaded: list[PredictiveModel] = []
"""The model of this process, if it is one of a pool."""


class PooledModel(PredictiveModel):
    """A model in processes of its own; a call goes to a free one, and waits for it.

    Args:
        make: Makes the model; it has to be pickled.
        count: Number of processes.

    Attributes:
        processor_s: Processor time of all calls so far [s].
    """

    def __init__(self, make: Make, *, count: int) -> None:
        model = make()
        self.name, self.version, self.largest_batch = model.name, model.version, model.largest_batch
        context = get_context("spawn")
        self._processes = [
            ProcessPoolExecutor(1, mp_context=context, initializer=_load, initargs=(make,)) for _ in range(count)
        ]
        self._free: queue.SimpleQueue[ProcessPoolExecutor] = queue.SimpleQueue()
        for process in self._processes:
            self._free.put(process)
        self._lock = Lock()
        self.processor_s = 0.0

    def prepare(self, state: State, actions: NDArray[np.float64]) -> None:
        """Let every process do what depends on the state alone."""
        for future in [process.submit(_predict, state, actions) for process in self._processes]:
            future.result()

    def outcomes(self, state: State, actions: NDArray[np.float64]) -> tuple[Floats, tuple[str, ...]]:
        """Return the model's heightmaps ``(B, H, W)`` [m] and warnings."""
        process = self._free.get()
        try:
            found, processor_s = process.submit(_predict, state, actions).result()
        finally:
            self._free.put(process)
        with self._lock:
            self.processor_s += processor_s
        return found.heights, found.warnings

    def close(self) -> None:
        """End the processes."""
        for process in self._processes:
            process.shutdown(cancel_futures=True)


def _load(make: Make) -> None:
    _loaded.append(make())


def _predict(state: State, actions: NDArray[np.float64]) -> tuple[Predictions, float]:
    began = time.process_time()
    found = _loaded[0].predict(state, actions)
    return found, time.process_time() - began
