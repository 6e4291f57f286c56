"""What a person's or a robot's side of the protocol needs: optimise, follow, report, look around."""

import queue
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass

import zenoh
import zenoh.ext

from common.domain.errors import CancelledError, RequestError, TimedOutError, UnavailableError
from common.wire.codec import Message, decode
from common.wire.keys import Address, alias, every_live, every_orchestrator, every_worker, parse_address, trial_key
from common.wire.messages import Card, Health
from common.wire.optimization import OptimizeReply, OptimizeRequest, Progress
from common.wire.query import NoReplyError, ask, never
from common.wire.report import TrialReply, TrialReport
from common.wire.session import is_connected

LONGEST_S = 24 * 3600.0
LOOK_S = 1.0
LAST_STEP_S = 5.0
RETRIES = 5
RETURN_S = 30.0
"""How long to wait for an orchestrator that was there and is gone: its process is restarted, or the connection."""


@dataclass(frozen=True)
class WorkerStatus:
    """A live worker; ``card`` and ``health`` are None if it did not answer in time."""

    address: Address
    card: Card | None
    health: Health | None


def optimize(
    session: zenoh.Session,
    request: OptimizeRequest,
    *,
    on_progress: Callable[[Progress], None] | None = None,
    timeout_s: float | None = None,
    cancelled: Callable[[], bool] = never,
) -> OptimizeReply:
    """Ask any orchestrator of the request's task for the best action.

    If the connection breaks or the orchestrator's process is killed, the same request is sent again, if need be after
    waiting `RETURN_S` for an orchestrator: one that works on it, has the answer by now or keeps a journal answers
    without paying for an evaluation twice. If the caller goes, by ``cancelled``, the timeout or an interrupt, the
    orchestrator is told to stop.

    Args:
        session: A client session.
        request: What to optimise.
        on_progress: Called with every step, in order, on a thread of the session; it must not block. What a second run
            of the request repeats is left out, so that the index of steps may jump there.
        timeout_s: When to give up, None: never [s].
        cancelled: Whether the answer is still wanted.

    Raises:
        UnavailableError: No orchestrator serves the task, or it is gone, or a model is missing.
        RequestError: The request is wrong.
        TimedOutError, CancelledError, ModelError: As their names say.
    """
    key = alias(request.task, "optimize")
    deadline = time.monotonic() + (timeout_s or LONGEST_S)
    steps = _Steps(on_progress)
    order = _Order(steps)

    def ask_once() -> OptimizeReply:
        left = deadline - time.monotonic()
        if on_progress is None:
            return ask(session, key, request, OptimizeReply, timeout_s=left, cancelled=cancelled)
        with _following(session, order, task=request.task, request_id=request.id):
            reply = ask(session, key, request, OptimizeReply, timeout_s=left, cancelled=cancelled)
            steps.last.wait(LAST_STEP_S)
            return reply

    attempts, was_there = 0, _is_served(session, request.task)
    try:
        while True:
            attempts += 1
            try:
                return ask_once()
            except NoReplyError:
                was_there = was_there or steps.any.is_set()
                patience_s = min(RETURN_S, deadline - time.monotonic()) if was_there else 0.0
                if attempts > RETRIES or not _returns(
                    session, request.task, patience_s=patience_s, cancelled=cancelled
                ):
                    raise
    except NoReplyError:
        raise UnavailableError(
            f"expected an orchestrator behind {key}, got no reply: none is alive, it stopped, or access was denied"
        ) from None
    except (CancelledError, TimedOutError, KeyboardInterrupt):
        cancel_optimization(session, task=request.task, request_id=request.id)
        raise


def _returns(session: zenoh.Session, task: str, *, patience_s: float, cancelled: Callable[[], bool]) -> bool:
    """Return whether an orchestrator is alive, now or within ``patience_s`` [s].

    Raises:
        CancelledError: ``cancelled`` said so.
    """
    deadline = time.monotonic() + patience_s
    while not cancelled():
        time.sleep(0.1)  # the token of a process that has just been killed may still be there
        if _is_served(session, task):
            return True
        if time.monotonic() >= deadline:
            return False
    raise CancelledError("the request was taken back while its orchestrator was gone")


def _is_served(session: zenoh.Session, task: str) -> bool:
    """Return whether an orchestrator of a task is alive."""
    if not is_connected(session):
        return False
    replies = session.liveliness().get(every_orchestrator(task, "live"), timeout=LOOK_S)
    return any(reply.ok is not None for reply in replies)


def report_trial(
    session: zenoh.Session, report: TrialReport, *, task: str, robot: str, timeout_s: float = 30.0
) -> TrialReply:
    """Report an executed action and return where it is kept, on disk.

    Without an answer it may be kept all the same: the same report, with its id, is sent again without harm.

    Raises:
        UnavailableError: No recorder serves the task, it is gone, or its disk refuses the trial.
        RequestError: The report is wrong, or a duplicate.
        TimedOutError: No answer came in time [s].
    """
    key = trial_key(task, robot)
    try:
        return ask(session, key, report, TrialReply, timeout_s=timeout_s)
    except NoReplyError:
        raise UnavailableError(
            f"expected a recorder behind {key}, got no reply: none is alive, it stopped, or access was denied"
        ) from None


def cancel_optimization(session: zenoh.Session, *, task: str, request_id: str) -> None:
    """Tell every orchestrator of a task that a request is not wanted any more."""
    session.get(
        every_orchestrator(task, f"cancel/{request_id}"),
        zenoh.handlers.Callback(lambda _: None, indirect=False),
        target=zenoh.QueryTarget.ALL,
        timeout=1.0,
    )


@contextmanager
def follow_progress(
    session: zenoh.Session, on_progress: Callable[[Progress], None], *, task: str = "*", request_id: str = "*"
) -> Iterator[None]:
    """Call back with every step of running and lately ended optimisations, those before this call included.

    Steps of one optimisation come once each and in the order of their index.
    """
    with _following(session, _Order(on_progress), task=task, request_id=request_id):
        yield


@contextmanager
def _following(session: zenoh.Session, order: "_Order", *, task: str, request_id: str) -> Iterator[None]:
    subscriber = zenoh.ext.declare_advanced_subscriber(
        session,
        every_orchestrator(task, f"progress/{request_id}"),
        order,
        history=zenoh.ext.HistoryConfig(detect_late_publishers=True),
    )
    try:
        yield
    finally:
        subscriber.undeclare()


class _Steps:
    """Passes on the steps of one optimisation; of what a second run of the request repeats only what is new.

    Attributes:
        any: Set by the first step.
        last: Set by the last step of a run.
    """

    def __init__(self, on_progress: Callable[[Progress], None] | None) -> None:
        self.any = threading.Event()
        self.last = threading.Event()
        self._on_progress = on_progress
        self._trials = 0

    def __call__(self, progress: Progress) -> None:
        is_first = not self.any.is_set()
        self.any.set()
        if progress.kind == "accepted":
            self.last.clear()
        if progress.trial is not None:
            is_new, self._trials = progress.trial.index >= self._trials, max(self._trials, progress.trial.index + 1)
        else:
            is_new = is_first or progress.kind != "accepted"
        if self._on_progress is not None and is_new:
            self._on_progress(progress)
        if progress.kind in ("finished", "failed"):
            self.last.set()


class _Order:
    """Puts the steps of each optimisation into the order of their index, and drops the ones seen already.

    Each run of a request counts from 0.
    """

    def __init__(self, on_progress: Callable[[Progress], None]) -> None:
        self._on_progress = on_progress
        self._next: dict[str, int] = {}
        self._early: dict[tuple[str, int], Progress] = {}
        self._lock = threading.Lock()

    def __call__(self, sample: zenoh.Sample) -> None:
        try:
            progress = decode(sample.payload.to_bytes(), str(sample.encoding), Progress)
        except RequestError:
            return
        key = f"{sample.key_expr} {progress.run}"
        with self._lock:
            due = self._next.get(key, 0)
            if progress.index >= due:
                self._early[key, progress.index] = progress
            while (ready := self._early.pop((key, due), None)) is not None:
                due += 1
                self._on_progress(ready)
            self._next[key] = due


def list_workers(session: zenoh.Session, *, task: str = "*", timeout_s: float = LOOK_S) -> tuple[WorkerStatus, ...]:
    """Return every live worker with its card and health, in the order of their addresses.

    A worker is alive if its token or one of its answers says so: Zenoh now and then returns no tokens to a session
    that has just subscribed to them, and a worker that hangs gives no answers.

    Raises:
        UnavailableError: The session has no router.
    """
    if not is_connected(session):
        raise UnavailableError("expected a router, got none: the session has lost it")
    gathered = _Gathered()
    session.liveliness().get(every_live(task), gathered.handler(), timeout=timeout_s)
    for leaf in ("card", "health"):
        session.get(
            every_worker(task, leaf),
            gathered.handler(),
            target=zenoh.QueryTarget.ALL,
            consolidation=zenoh.ConsolidationMode.NONE,
            timeout=timeout_s,
        )
    found = gathered.by_worker(time.monotonic() + timeout_s)
    return tuple(
        WorkerStatus(address, _read(leaves.get("card"), Card), _read(leaves.get("health"), Health))
        for address, leaves in sorted(found.items(), key=lambda item: item[0].prefix)
    )


class _Gathered:
    """The replies of several queries, by worker and leaf of the key."""

    def __init__(self) -> None:
        self._replies: queue.SimpleQueue[zenoh.Reply | None] = queue.SimpleQueue()
        self._open = 0

    def handler(self) -> "zenoh.handlers.Callback[zenoh.Reply]":
        self._open += 1
        return zenoh.handlers.Callback(self._replies.put, lambda: self._replies.put(None), indirect=False)

    def by_worker(self, deadline: float) -> dict[Address, dict[str, zenoh.Sample]]:
        found: dict[Address, dict[str, zenoh.Sample]] = {}
        while self._open:
            try:
                reply = self._replies.get(timeout=max(0.0, deadline - time.monotonic()))
            except queue.Empty:
                break
            if reply is None:
                self._open -= 1
            elif reply.ok is not None:
                with suppress(RequestError):
                    address, leaf = parse_address(str(reply.ok.key_expr))
                    found.setdefault(address, {})[leaf] = reply.ok
        return found


def _read(sample: zenoh.Sample | None, message: type[Message]) -> Message | None:
    if sample is None:
        return None
    try:
        return decode(sample.payload.to_bytes(), str(sample.encoding), message)
    except RequestError:
        return None
