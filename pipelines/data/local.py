"""Work on states in processes of this machine, each with one thread."""

import multiprocessing
import os
import signal
import threading
from collections.abc import Iterator
from concurrent.futures import ProcessPoolExecutor
from concurrent.futures.process import BrokenProcessPool
from contextlib import contextmanager
from functools import cache

from common.domain.errors import UnavailableError
from common.domain.model import PredictiveModel
from common.storage.dataset_card import DatasetPlan, Split
from common.storage.dataset_record import StateSamples
from pipelines.data.generate import Submit
from pipelines.data.sample import make_state

THREADS = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS")


@contextmanager
def local_workers(plan: DatasetPlan, workers: int) -> Iterator[Submit]:
    """Run simulators in processes of their own.

    Args:
        plan: What the data set is made from.
        workers: Number of processes.

    Raises:
        UnavailableError: A process ended.
    """
    with local_processes(workers) as processes:
        yield lambda split, index: processes.submit(_make, plan, split, index)


@contextmanager
def local_processes(workers: int) -> Iterator[ProcessPoolExecutor]:
    """Start processes that end when this one does, however that ends.

    Raises:
        UnavailableError: A process ended before its work was done.
    """
    for name in THREADS:
        os.environ.setdefault(name, "1")
    processes = ProcessPoolExecutor(workers, mp_context=multiprocessing.get_context("spawn"), initializer=_begin)
    try:
        yield processes
    except BrokenProcessPool:
        raise UnavailableError(
            "expected all worker processes to live, got the end of one; the same command goes on where it stopped"
        ) from None
    finally:
        processes.shutdown(wait=True, cancel_futures=True)


def _begin() -> None:
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    threading.Thread(target=_end_with_parent, daemon=True).start()


def _end_with_parent() -> None:
    parent = multiprocessing.parent_process()
    assert parent is not None
    parent.join()
    os._exit(1)


def _make(plan: DatasetPlan, split: Split, index: int) -> StateSamples:
    from services.simulator.settle import settle_boxes

    return make_state(plan, split, index, settle=settle_boxes, model=_simulator(plan.level))


@cache
def _simulator(level: str) -> PredictiveModel:
    from services.simulator.model import SimulatorModel

    model = SimulatorModel.at_level(level)
    model.warm()
    return model
