"""The journal of an optimisation: what it has found out so far, so that an interruption costs nothing twice."""

import fcntl
import logging
import os
import re
import threading
import time
from contextlib import suppress
from io import FileIO
from pathlib import Path
from types import TracebackType
from typing import Literal, Self

import numpy as np
from pydantic import BaseModel, ConfigDict

from common.domain.errors import CancelledError, TimedOutError, UnavailableError
from common.planning.evaluation import Evaluation
from common.wire.array import Array
from common.wire.messages import ErrorReply
from common.wire.optimization import EventMessage, TrialMessage

log = logging.getLogger(__name__)

INTERRUPTIONS = (CancelledError, TimedOutError, UnavailableError)
"""Ends of an optimisation after which the same request may come again and find more."""
LARGEST_BYTES = 256 * 2**20
"""A journal does not grow beyond this: 5000 evaluations on 96 x 96 cells; what comes later is not kept."""
MOST_FILES = 64
MOST_BYTES = 512 * 2**20
OLDEST_S = 7 * 24 * 3600.0
"""Journals that nobody came back for are removed at this age, and the oldest first beyond these numbers."""
NAME = re.compile(r"[0-9a-f]{64}\.jsonl")


class Line(BaseModel):
    """A line of a journal."""

    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False)


class Course(Line):
    """The first line: what the course of the optimisation depends on besides its request.

    Attributes:
        models: Names of the models, in the order in which the strategy saw them.
        estimators: Names of the models that had an MDE.
        in_flight: Number of evaluations at the same time.
    """

    format: Literal[1] = 1
    models: tuple[str, ...]
    estimators: tuple[str, ...]
    in_flight: int


class EvaluationLine(Line):
    """Every other line: an evaluation, as in `common.planning.evaluation.Evaluation`."""

    trial: TrialMessage
    heights: Array | None
    split_s: dict[str, float]
    events: tuple[EventMessage, ...]
    failure: ErrorReply | None

    @classmethod
    def of(cls, evaluation: Evaluation) -> Self:
        """Return an evaluation as a line."""
        return cls(
            trial=TrialMessage.of(evaluation.trial),
            heights=None if evaluation.heights is None else Array.of(evaluation.heights),
            split_s=dict(evaluation.split_s),
            events=tuple(EventMessage.of(event) for event in evaluation.events),
            failure=None if evaluation.failure is None else ErrorReply.of(evaluation.failure),
        )

    def evaluation(self) -> Evaluation:
        """Return the evaluation."""
        return Evaluation(
            trial=self.trial.trial(),
            heights=None if self.heights is None else np.asarray(self.heights.values(), dtype=np.float32),
            split_s=self.split_s,
            events=tuple(event.event() for event in self.events),
            failure=None if self.failure is None else self.failure.error(),
        )


class Journal:
    """One optimisation's journal, as a context; without a file it keeps nothing and costs nothing.

    Leaving the context removes the file, unless one of `INTERRUPTIONS` ended the optimisation and some reward is known.
    Safe to use from several threads, also after its end. Trouble with the disk is logged and never raised.

    Attributes:
        course: What the interrupted run's course depended on; None if there was none, or it had found nothing yet.
        evaluations: What the interrupted run found out, by index.
    """

    def __init__(self, file: FileIO | None, path: Path) -> None:
        self.course: Course | None = None
        self.evaluations: dict[int, Evaluation] = {}
        self._file = file
        self._path = path
        self._size = 0
        self._is_full = False
        self._is_worth_keeping = False
        self._lock = threading.Lock()
        if file is not None:
            self._read(file)

    def __enter__(self) -> Self:
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, _: TracebackType | None) -> None:
        with self._lock:
            if self._file is None:
                return
            with self._file, suppress(OSError):
                if not (self._is_worth_keeping and isinstance(error, INTERRUPTIONS)):
                    self._path.unlink()
            self._file = None

    def begin(self, *, models: tuple[str, ...], estimators: tuple[str, ...], in_flight: int) -> Course:
        """Write down what the course depends on and return it; a run that is resumed keeps its own."""
        if self.course is not None:
            return self.course
        course = Course(models=models, estimators=estimators, in_flight=in_flight)
        self._write(course)
        return course

    def append(self, evaluation: Evaluation) -> None:
        """Write down an evaluation."""
        self._write(EvaluationLine.of(evaluation))
        self._is_worth_keeping |= evaluation.trial.reward is not None

    def _write(self, line: Line) -> None:
        with self._lock:
            if self._file is None or self._is_full:
                return
            data = line.model_dump_json().encode() + b"\n"
            problem = f"it has {self._size} bytes already"
            if self._size + len(data) <= LARGEST_BYTES:
                try:
                    written = self._file.write(data)
                    problem = f"only {written} of {len(data)} bytes could be written"
                    if written == len(data):
                        self._size += len(data)
                        return
                except OSError as error:
                    problem = str(error)
            self._is_full = True
            log.warning("%s: expected room for the next evaluation, from here on none is kept: %s", self._path, problem)
            with suppress(OSError):
                self._file.truncate(self._size)

    def _read(self, file: FileIO) -> None:
        """Take over what is whole, up to the first line that is not; forget a run that had no reward yet."""
        whole = 0
        file.seek(0)
        with open(file.fileno(), "rb", closefd=False) as lines:
            for number, line in enumerate(lines):
                try:
                    if not line.endswith(b"\n"):
                        raise ValueError(f"no end after {len(line)} bytes")
                    if number == 0:
                        self.course = Course.model_validate_json(line)
                    else:
                        known = EvaluationLine.model_validate_json(line).evaluation()
                        self.evaluations[known.trial.index] = known
                except ValueError as error:
                    text = str(error).partition("\n")[0]
                    log.warning(
                        "%s: expected line %d to be whole, dropped it and the rest: %s", self._path, number, text
                    )
                    break
                whole += len(line)
        self._is_worth_keeping = any(known.trial.reward is not None for known in self.evaluations.values())
        if not self._is_worth_keeping:
            self.course, whole = None, 0
            self.evaluations.clear()
        file.truncate(whole)
        self._size = whole


def open_journal(folder: Path | None, name: str) -> Journal:
    """Return the journal of the optimisation with this name, 64 hexadecimal digits.

    It keeps nothing if there is no folder, if the disk refuses it, or while another process or thread runs the same
    optimisation. Old journals in the folder are removed first.
    """
    if folder is None:
        return Journal(None, Path(name))
    path = folder / f"{name}.jsonl"
    try:
        folder.mkdir(parents=True, exist_ok=True)
        _tidy(folder, but=path)
        file = _locked(path)
        if file is None:
            log.warning("%s: expected nobody to write it, somebody does: this run is not kept", path)
        return Journal(file, path)
    except OSError as error:
        log.warning("%s: expected a journal that can be written, this run is not kept: %s", path, error)
        return Journal(None, path)


def _locked(path: Path) -> FileIO | None:
    """Open a file to be read and appended to; None if it is open already. The lock ends with the process."""
    file = FileIO(path, "a+")
    try:
        fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
        if os.fstat(file.fileno()).st_nlink:
            return file
    except BlockingIOError:
        pass
    except OSError:
        file.close()
        raise
    file.close()
    return None


def _tidy(folder: Path, *, but: Path) -> None:
    """Remove journals that are too old or too many, the oldest first, except those that are being written."""
    found: list[tuple[float, int, Path]] = []
    for path in folder.iterdir():
        if NAME.fullmatch(path.name) and path != but:
            with suppress(OSError):  # somebody else removed it
                about = path.stat()
                found.append((about.st_mtime, about.st_size, path))
    total = 0
    for number, (written, size, path) in enumerate(sorted(found, reverse=True), 1):
        total += size
        if number < MOST_FILES and total <= MOST_BYTES and time.time() - written <= OLDEST_S:
            continue
        with suppress(OSError):
            file = _locked(path)
            if file is not None:
                with file:
                    path.unlink()
