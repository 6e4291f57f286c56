"""Work on states in processes of this machine, each with one thread."""

import multiprocessing
import os
import signal
import threading
from collections.abc import Iterator
from concurrent.futures import ProcessPoolExecutor
from concurrent.futures.process import BrokenProcessPool
from contextlib import contextmanager

from common.domain.errors import UnavailableError
from common.domain.model import PredictiveModel
from common.storage.dataset_card import DatasetPlan, Split
from common.storage.dataset_record import StateSamples
from common.tasks.plating_sampler import Settler
from pipelines.data.generate import Submit
from pipelines.data.sample import make_state

THREADS = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS")

_model: PredictiveModel | None = None
_settle: Settler | None = None


@contextmanager
def local_workers(plan: DatasetPlan, workers: int) -> Iterator[Submit]:
    """Run simulators in processes of their own, which end when this process does, however that ends.

    Args:
        plan: What the data set is made from.
        workers: Number of processes.

    Raises:
        UnavailableError: A process ended.
    """
    for name in THREADS:
        os.environ.setdefault(name, "1")
    context = multiprocessing.get_context("spawn")
    pool = ProcessPoolExecutor(workers, mp_context=context, initializer=_begin, initargs=(plan.level,))
    try:
        yield lambda split, index: pool.submit(_make, plan, split, index)
    except BrokenProcessPool:
        raise UnavailableError("expected all worker processes to live, got the end of one: run it again") from None
    finally:
        pool.shutdown(wait=True, cancel_futures=True)


def _begin(level: str) -> None:
    from services.simulator.model import SimulatorModel
    from services.simulator.settings import LEVELS
    from services.simulator.settle import settle_boxes

    global _model, _settle
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    threading.Thread(target=_end_with_parent, daemon=True).start()
    model = SimulatorModel(settings=LEVELS[level])
    model.warm()
    _model, _settle = model, settle_boxes


def _end_with_parent() -> None:
    parent = multiprocessing.parent_process()
    if parent is not None:
        parent.join()
        os._exit(1)


def _make(plan: DatasetPlan, split: Split, index: int) -> StateSamples:
    assert _model is not None
    assert _settle is not None
    return make_state(plan, split, index, settle=_settle, model=_model)
