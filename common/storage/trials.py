"""The record of what robots executed: one case file a trial, appended durably and never changed."""

import errno
import fcntl
import hashlib
import logging
import os
import threading
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from datetime import datetime
from pathlib import Path
from types import TracebackType
from typing import Self

import numpy as np

from common.domain.case import Case
from common.domain.errors import RequestError, UnavailableError
from common.domain.executed import added_volume, item_volume
from common.domain.grid import Grid
from common.storage.cases import encode_case
from common.storage.trial_files import PARTIAL, RecordedTrial, find_trials, number_of

log = logging.getLogger(__name__)


def trial_digest(case: Case) -> str:
    """Return what makes two trials the same: SHA-256 in hex over state, action and outcome.

    The bytes are the state's digest (32), the action as float64 and the outcome as float32, little-endian in C order.
    """
    action = np.array(case.true_action, "<f8").tobytes()
    outcome = np.ascontiguousarray(case.target, "<f4").tobytes()
    return hashlib.sha256(bytes.fromhex(case.state.digest) + action + outcome).hexdigest()


@dataclass(frozen=True)
class ExecutedTrial:
    """A trial on its way into the record.

    Attributes:
        robot: Who executed it.
        id: The report's identifier: a repeated report has the same.
        case: State, executed action as ``true_action``, outcome as ``target``.
        received: When it came, with its time zone.
    """

    robot: str
    id: str
    case: Case
    received: datetime


class TrialStore:
    """A folder of trials that grows; as a context, it is this process's alone. Safe to use from several threads.

    Args:
        folder: Where the trials are; made if there is none.
        task: The only task whose trials are taken.
        grid: The only grid that is taken; None: that of the first trial.

    Raises:
        RequestError: The folder holds trials of another task or grid.
        UnavailableError: Another process writes to it, or the disk refuses it.
    """

    def __init__(self, folder: Path, *, task: str, grid: Grid | None = None) -> None:
        self.folder, self.task = folder, task
        self._lock = threading.Lock()
        try:
            _make(folder)
            self._descriptor = os.open(folder, os.O_RDONLY | os.O_DIRECTORY)
        except OSError as error:
            raise UnavailableError(f"expected a folder for trials in {folder}, got: {error}") from None
        try:
            self._claim()
            found = find_trials(folder)
            for problem in found.broken:
                log.warning("left out of the record: %s", problem)
            self._by_digest = {trial.digest: trial for trial in found.trials}
            self._by_report = {(trial.robot, trial.id): trial for trial in found.trials}
            self._last = max((number_of(path.name) or 0 for path in folder.iterdir()), default=0)
            self.grid = self._agreed(found.trials, grid)
        except BaseException:
            os.close(self._descriptor)
            raise

    def __enter__(self) -> Self:
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, _: TracebackType | None) -> None:
        self.close()

    def __len__(self) -> int:
        return len(self._by_digest)

    def close(self) -> None:
        """Let others write to the folder."""
        descriptor, self._descriptor = self._descriptor, -1
        if descriptor >= 0:
            os.close(descriptor)

    def append(self, trial: ExecutedTrial) -> RecordedTrial:
        """Return where a trial is kept, once it is on disk. The same report again gets the same answer.

        Raises:
            RequestError: Its task or grid is not the record's, the record has the same state, action and outcome by
                another report, or another trial by the same one.
            UnavailableError: The disk refuses it or may not hold it; the same report can be sent again.
        """
        digest = trial_digest(trial.case)
        with self._lock:
            known = self._known(trial, digest)
            if known is None:
                self._check(trial.case)
                known = self._write(trial, digest)
            with _told(self.folder):
                os.fsync(self._descriptor)
            return known

    def _known(self, trial: ExecutedTrial, digest: str) -> RecordedTrial | None:
        same, reported = self._by_digest.get(digest), self._by_report.get((trial.robot, trial.id))
        if same is not None and same is not reported:
            raise RequestError(
                f"expected a new trial, got a duplicate: trial {same.number}, reported by {same.robot} as {same.id}, "
                "has this state, action and outcome"
            )
        if reported is not None and reported.digest != digest:
            raise RequestError(
                f"id: expected one that {trial.robot} has not used, got {trial.id}: trial {reported.number} has it"
            )
        return same

    def _check(self, case: Case) -> None:
        if case.task != self.task:
            raise RequestError(f"task: expected {self.task}, got {case.task}")
        if self.grid is not None and case.state.grid != self.grid:
            raise RequestError(f"grid: expected {self.grid} as the record has it, got {case.state.grid}")

    def _write(self, trial: ExecutedTrial, digest: str) -> RecordedTrial:
        case, grid = trial.case, trial.case.state.grid
        recorded = RecordedTrial(
            number=self._last + 1,
            robot=trial.robot,
            id=trial.id,
            received=trial.received,
            digest=digest,
            task=case.task,
            action=case.true_action or (),
            rows=grid.rows,
            columns=grid.columns,
            cell=grid.cell,
            rigid=case.state.item.is_rigid,
            item_volume=item_volume(case.state),
            added_volume=added_volume(case.state, case.target),
        )
        content = encode_case(case, trial=recorded.entry())
        path = self.folder / recorded.file
        unfinished = self.folder / f".{recorded.file}{PARTIAL}"
        with _told(path):
            try:
                with unfinished.open("wb") as file:
                    file.write(content)
                    file.flush()
                    os.fsync(file.fileno())
                unfinished.rename(path)
            finally:
                unfinished.unlink(missing_ok=True)
        self._last, self.grid = recorded.number, grid
        self._by_digest[digest] = self._by_report[trial.robot, trial.id] = recorded
        return recorded

    def _claim(self) -> None:
        try:
            fcntl.flock(self._descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except OSError as error:
            if error.errno not in (errno.EAGAIN, errno.EACCES):
                raise UnavailableError(f"{self.folder}: expected a folder that can be locked, got: {error}") from None
            raise UnavailableError(
                f"expected {self.folder} for this recorder alone, got another process that writes to it"
            ) from None
        for left in self.folder.glob(f".*{PARTIAL}"):
            left.unlink()

    def _agreed(self, trials: Iterable[RecordedTrial], grid: Grid | None) -> Grid | None:
        for trial in trials:
            if trial.task != self.task:
                raise RequestError(f"{self.folder}: expected trials of {self.task}, got {trial.file} of {trial.task}")
            grid = grid or trial.grid
            if trial.grid != grid:
                raise RequestError(f"{self.folder}: expected trials on {grid}, got {trial.file} on {trial.grid}")
        return grid


def _make(folder: Path) -> None:
    """Make a folder, and have its name on disk."""
    if folder.is_dir():
        return
    _make(folder.absolute().parent)
    folder.mkdir(exist_ok=True)
    parent = os.open(folder.absolute().parent, os.O_RDONLY | os.O_DIRECTORY)
    try:
        os.fsync(parent)
    finally:
        os.close(parent)


@contextmanager
def _told(path: Path) -> Iterator[None]:
    """Tell trouble with the disk as nobody's fault, so that the caller sends again what was not kept."""
    try:
        yield
    except OSError as error:
        raise UnavailableError(f"{path}: expected room on a disk that can be written, got: {error}") from None
