"""Generate a data set: hand out its states until enough samples have come to rest, and write them down as they come."""

from collections.abc import Callable
from concurrent.futures import FIRST_COMPLETED, Future, wait
from pathlib import Path

from common.storage.dataset import Dataset
from common.storage.dataset_card import SPLITS, DatasetPlan, Split
from common.storage.dataset_record import StateSamples
from common.storage.dataset_writer import DatasetWriter

Submit = Callable[[Split, int], "Future[StateSamples]"]
"""Starts the work on one state of a split."""

Report = Callable[[Split, int], None]
"""Is told how many samples of a split have come to rest."""


def generate(path: Path, plan: DatasetPlan, *, submit: Submit, in_flight: Callable[[], int], report: Report) -> Dataset:
    """Make what is missing of a data set, and return it complete.

    States are handed out in order. A split is complete when the first of them hold the wanted number of settled
    samples, whoever made them and in whatever order they came.

    Args:
        path: Folder of the data set.
        plan: What it is made from.
        submit: Starts the work on a state.
        in_flight: Tells how many states should be at work now.
        report: Called whenever a state is there.

    Raises:
        RequestError: The folder holds something else, or a data set of another plan.
        UnavailableError: Another process writes to it.
    """
    with DatasetWriter(path, plan) as writer:
        if not writer.is_complete:
            for split in SPLITS:
                _make_split(writer, split, submit=submit, in_flight=in_flight, report=report)
        return writer.finish()


def _make_split(
    writer: DatasetWriter, split: Split, *, submit: Submit, in_flight: Callable[[], int], report: Report
) -> None:
    wanted, per_state = writer.plan.counts[split], writer.plan.actions_per_state
    pending: set[Future[StateSamples]] = set()
    index = 0
    try:
        while True:
            there = writer.settled(split)
            report(split, min(sum(there.values()), wanted))
            while len(pending) < in_flight() and _expected(there, index, per_state) < wanted:
                if index not in there:
                    pending.add(submit(split, index))
                index += 1
            if not pending:
                return
            done, pending = wait(pending, return_when=FIRST_COMPLETED)
            for future in done:
                writer.add(split, future.result())
    finally:
        for future in pending:
            future.cancel()


def _expected(there: dict[int, int], handed_out: int, per_state: int) -> int:
    """Return how many settled samples the states handed out so far will hold if those at work all come to rest."""
    return sum(there.get(index, per_state) for index in range(handed_out))
