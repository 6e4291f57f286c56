"""One call to whichever worker of a kind can answer it, and what to do when one cannot."""

import math
import time
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Generic

import zenoh

from common.domain.errors import (
    BusyError,
    CancelledError,
    FrugalError,
    ModelError,
    TimedOutError,
    UnavailableError,
    UnknownStateError,
)
from common.domain.grid import Grid
from common.domain.model import Event
from common.wire.codec import Message
from common.wire.directory import Directory, describe
from common.wire.keys import Address, Role
from common.wire.messages import StateRequest
from common.wire.query import NoReplyError, ask, never

PATIENCE_S = 1.0
PARTITION_S = 4.0
SILENCES = 5
FIRST_PAUSE_S, LONGEST_PAUSE_S = 0.02, 0.5


def endless() -> float:
    """Return infinity: there is no budget."""
    return math.inf


@dataclass(frozen=True)
class Limits:
    """How long a call may take, and whether it is still wanted.

    Attributes:
        timeout_s: Longest time for one worker to answer, and to keep asking busy ones [s].
        remaining: The budget that is left for everything [s].
        cancelled: Whether the call was taken back.
    """

    timeout_s: float = 60.0
    remaining: Callable[[], float] = endless
    cancelled: Callable[[], bool] = never


@dataclass(frozen=True)
class Question(Generic[Message]):
    """What to ask workers of one kind.

    Attributes:
        role: Their role.
        model: Their model.
        leaf: The endpoint.
        request: The request with the state named by its digest only.
        content: The same request with the state itself.
        grid: The grid of the state; only workers that take it are asked.
        batch: Number of actions.
        reply: The message to expect.
        check: Raises `ModelError` on a reply that cannot be right.
    """

    role: Role
    model: str
    leaf: str
    request: StateRequest
    content: Callable[[], StateRequest]
    grid: Grid
    batch: int
    reply: type[Message]
    check: Callable[[Message], None]


@dataclass(frozen=True)
class Answer(Generic[Message]):
    """A reply, who gave it, how long that took in all [s], and what went wrong before."""

    reply: Message
    address: Address
    seconds: float
    events: tuple[Event, ...]


def dispatch(directory: Directory, question: Question[Message], limits: Limits) -> Answer[Message]:
    """Ask the least loaded worker, and others where it fails.

    No reply: the worker is suspect and another one is asked. Busy: another one, then all again after a pause. An error
    by the model's fault or a timeout: once elsewhere. An error by the request's fault: raised at once. If the router is
    lost, wait for it; if nobody is there, wait for `PATIENCE_S` only.

    Raises:
        UnavailableError: Nobody can serve it; the text names who is missing and what was tried.
        TimedOutError: Two workers, or the only one, took too long, or the budget ended.
        ModelError: Two workers, or the only one, failed or answered nonsense.
        RequestError: The request is wrong.
        CancelledError: It was taken back.
    """
    return _Dispatch(directory, question, limits).run()


@dataclass
class _Dispatch(Generic[Message]):
    directory: Directory
    question: Question[Message]
    limits: Limits
    began: float = field(default_factory=time.monotonic)
    events: list[Event] = field(default_factory=list)
    failed: dict[Address, FrugalError] = field(default_factory=dict)
    silent: dict[Address, FrugalError] = field(default_factory=dict)
    busy: set[Address] = field(default_factory=set)
    silences: int = 0
    pause_s: float = FIRST_PAUSE_S

    def run(self) -> Answer[Message]:
        while True:
            address = self._next()
            try:
                reply = self._ask(address)
            except BusyError as error:
                self.busy.add(address)
                self._note("busy", address, error)
            except UnavailableError as error:
                self._silence(address, error)
            except TimedOutError as error:
                self._fail("timed_out", address, error)
            except ModelError as error:
                self._fail("model_error", address, error)
            else:
                return Answer(reply, address, time.monotonic() - self.began, tuple(self.events))
            finally:
                self.directory.release(address)

    def _next(self) -> Address:
        """Claim whom to ask now; wait if somebody may still come."""
        role, model = self.question.role, self.question.model
        nobody_since: float | None = None
        while True:
            self._check_limits()
            if not self.directory.is_partitioned():
                tried = {*self.failed, *self.silent, *self.busy}
                address = self.directory.claim(role, model, grid=self.question.grid, exclude=tried)
                if address is not None:
                    return address
                if self.busy:
                    self._pause()
                    continue
                if self.failed:
                    raise next(iter(self.failed.values()))
            self.directory.look()
            now = time.monotonic()
            nobody_since = nobody_since or now
            patience_s = PARTITION_S if self.directory.was_partitioned(PARTITION_S) else PATIENCE_S
            if now - nobody_since >= patience_s or self.silences >= SILENCES:
                raise UnavailableError(self._who_is_missing())
            self.directory.wait_for_change(0.05)
            if now - nobody_since >= 0.1:
                self.silent.clear()

    def _ask(self, address: Address) -> Message:
        digest = self.question.request.state or ""
        request = self.question.request if self.directory.holds(address, digest) else self.question.content()
        try:
            reply = self._send(address, request)
        except UnknownStateError:
            reply = self._send(address, self.question.content())
        return reply

    def _send(self, address: Address, request: StateRequest) -> Message:
        timeout_s = min(self.limits.timeout_s, self.limits.remaining())
        watch = _Watch(self.directory, address, self.question.batch, self.limits.cancelled)
        key = address.key(self.question.leaf)
        try:
            reply = ask(self.directory.session, key, request, self.question.reply, timeout_s=timeout_s, cancelled=watch)
        except CancelledError:
            cancel(self.directory.session, address, request.id)
            if watch.is_silent:
                raise NoReplyError(f"{address.worker}: expected it to answer its health key, got nothing") from None
            raise
        self.question.check(reply)
        return reply

    def _silence(self, address: Address, error: UnavailableError) -> None:
        self.silent[address] = error
        self.silences += 1
        if not self.directory.is_partitioned():
            self.directory.suspect(address)
            self.directory.probe(address)
        self._note("no_reply" if isinstance(error, NoReplyError) else "unavailable", address, error)

    def _fail(self, kind: str, address: Address, error: FrugalError) -> None:
        self.directory.suspect(address)
        self._note(kind, address, error)
        self.failed[address] = error
        if len(self.failed) > 1:
            raise error

    def _note(self, kind: str, address: Address, error: FrugalError) -> None:
        self.events.append(Event(kind, address.worker, str(error), time.monotonic() - self.began))

    def _pause(self) -> None:
        if time.monotonic() - self.began > self.limits.timeout_s:
            names = ", ".join(sorted(address.worker for address in self.busy))
            raise BusyError(f"expected a free worker within {self.limits.timeout_s:.3g} s, got busy from {names}")
        self.directory.wait_for_change(self.pause_s)
        self.pause_s = min(2 * self.pause_s, LONGEST_PAUSE_S)
        self.busy.clear()

    def _check_limits(self) -> None:
        if self.limits.cancelled():
            raise CancelledError("the call was taken back")
        if self.limits.remaining() <= 0:
            raise TimedOutError(f"expected an answer within the budget, got none{self._tried()}")

    def _who_is_missing(self) -> str:
        kind = describe(self.question.role, self.question.model)
        if self.directory.is_partitioned():
            return f"expected a router, got none for {PARTITION_S:g} s, so {kind} cannot be reached{self._tried()}"
        others = {worker.address.worker for worker in self.directory.workers(self.question.role, self.question.model)}
        if others - {event.worker for event in self.events}:
            kind = f"{kind} that takes {self.question.grid}"
        return f"expected a live worker for {kind} of {self.directory.task}, got none{self._tried()}"

    def _tried(self) -> str:
        tried = ", ".join(f"{event.worker} ({event.kind})" for event in self.events[-5:])
        return f"; tried {tried}" if tried else ""


class _Watch:
    """Ends the waiting for a reply when it was taken back, or its worker is overdue and does not answer at all."""

    def __init__(self, directory: Directory, address: Address, batch: int, cancelled: Callable[[], bool]) -> None:
        expected_s = directory.cost_s(address.role, address.model, batch=batch)
        self._patience_s = 5.0 if expected_s is None else 1.0 + 3 * expected_s
        self._probe_at = time.monotonic() + self._patience_s
        self._directory = directory
        self._address = address
        self._cancelled = cancelled
        self.is_silent = False

    def __call__(self) -> bool:
        if self._cancelled():
            return True
        if time.monotonic() >= self._probe_at:
            self.is_silent = not self._directory.answers(self._address)
            self._probe_at = time.monotonic() + self._patience_s
        return self.is_silent


def cancel(session: zenoh.Session, address: Address, request_id: str) -> None:
    """Tell a worker that a request is not wanted any more, without waiting for its answer."""
    session.get(
        address.key(f"cancel/{request_id}"), zenoh.handlers.Callback(lambda _: None, indirect=False), timeout=1.0
    )
