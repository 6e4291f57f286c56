"""Turns a table of endpoints into a worker: a bounded queue, threads that compute, and keys that always answer."""

import logging
import queue
import threading
import time
from collections.abc import Callable, Sequence
from contextlib import suppress
from functools import partial

import zenoh
from pydantic import BaseModel

from common.domain.errors import (
    BusyError,
    CancelledError,
    ExpiredError,
    FrugalError,
    ModelError,
    RequestError,
    UnavailableError,
)
from common.wire.call import Call
from common.wire.cost import CostMeter
from common.wire.endpoint import Alias, Endpoint
from common.wire.job import Job
from common.wire.keys import Address, check_name
from common.wire.messages import CancelReply, Card, ErrorReply, Health, Reply
from common.wire.metrics import ENCODING, exposition
from common.wire.optimization import Progress
from common.wire.progress import ProgressBoard
from common.wire.replies import ReplyCache

log = logging.getLogger(__name__)

MOST_FOLLOWERS = 8
"""Queries that may wait for the answer to the same request besides the first."""

MOST_APART = 2
"""Requests that may wait for the endpoints that are computed apart."""

Waiting = queue.Queue[Job | None]


class Host:
    """One worker on a session.

    Requests are read and prepared as they come and wait in a bounded queue; ``threads`` threads compute, one request
    each. Endpoints that are ``apart`` share one more queue and thread. ``card``, ``health``, ``metrics`` and
    ``cancel/<id>`` are answered meanwhile.
    """

    def __init__(
        self,
        session: zenoh.Session,
        card: Card,
        endpoints: Sequence[Endpoint],
        *,
        threads: int = 1,
        queue_length: int = 16,
        meter: CostMeter | None = None,
    ) -> None:
        self.address = Address(card.task, card.role, card.model, card.instance)
        self._session = session
        self._card = card
        self._endpoints = tuple(endpoints)
        self._meter = meter or CostMeter()
        self._queue: Waiting = queue.Queue(maxsize=queue_length)
        self._apart: Waiting = queue.Queue(maxsize=MOST_APART)
        self._jobs: dict[Job, Call] = {}
        self._lock = threading.RLock()
        self._stopping = False
        self._served = self._failed = self._refused = 0
        self._began = time.monotonic()
        self._replies = ReplyCache()
        self._board = ProgressBoard(session, self.address)
        self._queryables: list[zenoh.Queryable[None]] = []
        self._subscribers: list[zenoh.Subscriber[None]] = []
        self._card_queryable: zenoh.Queryable[None] | None = None
        self._token: zenoh.LivelinessToken | None = None
        queues = {f"compute-{number}": self._queue for number in range(threads)}
        if any(endpoint.apart for endpoint in endpoints):
            queues["apart"] = self._apart
        self._threads = {
            threading.Thread(target=self._work, args=(waiting,), name=name, daemon=True): waiting
            for name, waiting in queues.items()
        }

    def start(self) -> None:
        """Declare every key, the liveliness token last, and begin to compute."""
        for thread in self._threads:
            thread.start()
        for endpoint in self._endpoints:
            for name in (Alias(self.address.key(endpoint.leaf)), *endpoint.aliases):
                receive = self._receive if name.complete else self._refuse
                self._declare(name.key, partial(receive, endpoint, name), complete=name.complete)
                if endpoint.takes_puts and name.complete:
                    hear = partial(self._hear, endpoint)
                    self._subscribers.append(self._session.declare_subscriber(name.key, hear))
        health, card = self.address.key("health"), self.address.key("card")
        self._declare(health, partial(self._tell, health, self.health))
        self._declare(self.address.key("metrics"), self._tell_metrics)
        self._declare(self.address.key("cancel/*"), self._cancel)
        tell_card = partial(self._tell, card, self.card)
        self._card_queryable = self._session.declare_queryable(card, tell_card, complete=True)
        self._token = self._session.liveliness().declare_token(self.address.key("live"))
        log.info("%s serves", self.address.prefix)

    def stop(self, *, grace_s: float) -> bool:
        """Leave: hide card and token, turn away what waits, give what is computed ``grace_s`` [s], undeclare the rest.

        Returns:
            Whether every computation ended; if not, its caller was told that the worker is gone.
        """
        if self._token is not None and self._card_queryable is not None:
            self._card_queryable.undeclare()
            self._token.undeclare()
        for subscriber in self._subscribers:
            subscriber.undeclare()
        gone = UnavailableError(f"{self.address.worker}: the worker is stopping")
        deadline = time.monotonic() + grace_s
        with self._lock:
            self._stopping = True
            unbegun = [job for job in self._jobs if job.begun is None]
        for job in unbegun:
            self._end(job, gone)
        while self._jobs and time.monotonic() < deadline:
            time.sleep(0.01)
        with self._lock:
            late = list(self._jobs.items())
        for job, call in late:
            call.cancel()
            self._end(job, gone)
        for waiting in self._threads.values():
            with suppress(queue.Full):
                waiting.put(None, timeout=0.2)
        for thread in self._threads:
            thread.join(timeout=2.0)
        for queryable in self._queryables:
            queryable.undeclare()
        self._board.close()
        return not any(thread.is_alive() for thread in self._threads)

    def update_card(self, **changes: object) -> None:
        """Change what the card says, the version for instance."""
        self._card = self._card.model_copy(update=changes)

    def card(self) -> Card:
        """Return the worker's card with the costs measured so far."""
        return self._card.model_copy(update={"cost": self._meter.costs()})

    def health(self) -> Health:
        """Return how the worker is doing."""
        now = time.monotonic()
        with self._lock:
            begun = [job.begun for job in self._jobs if job.begun is not None]
            return Health(
                status="stopping" if self._stopping else "ok",
                queue_length=len(self._jobs) - len(begun),
                in_progress=len(begun),
                computing_s=now - min(begun) if begun else None,
                served=self._served,
                failed=self._failed,
                refused=self._refused,
                uptime_s=now - self._began,
                cost=self._meter.costs(),
            )

    def _declare(self, key: str, callback: Callable[[zenoh.Query], None], *, complete: bool = True) -> None:
        self._queryables.append(self._session.declare_queryable(key, callback, complete=complete))

    def _refuse(self, endpoint: Endpoint, name: Alias, query: zenoh.Query) -> None:
        """Answer what no worker of its task took; what came on a complete alias is answered there."""
        key = name.answer_key(str(query.key_expr))
        if key is None or any(query.key_expr.intersects(alias.key) for alias in endpoint.aliases if alias.complete):
            query.drop()
            return
        job = Job(query, key)
        try:
            job.read(endpoint.request)
            raise RequestError(f"task: expected {self.address.task}, got {query.key_expr}, which nobody serves")
        except FrugalError as error:
            self._end(job, error)

    def _receive(self, endpoint: Endpoint, name: Alias, query: zenoh.Query) -> None:
        key = name.answer_key(str(query.key_expr))
        if key is None:
            query.drop()
        else:
            self._take(endpoint, Job(query, key))

    def _hear(self, endpoint: Endpoint, sample: zenoh.Sample) -> None:
        self._take(endpoint, Job(sample, str(sample.key_expr)))

    def _take(self, endpoint: Endpoint, job: Job) -> None:
        try:
            known = self._admit(endpoint, job)
        except FrugalError as error:
            self._end(job, error)
        except Exception as error:
            log.exception("%s: a request could not be prepared", self.address.worker)
            self._end(job, ModelError(f"{self.address.worker}: the request could not be prepared: {_brief(error)}"))
        else:
            if known is not None:
                self._end(job, known)

    def _admit(self, endpoint: Endpoint, job: Job) -> Reply | None:
        if endpoint.exact and job.asked != job.key:
            raise RequestError(f"expected a query to {job.key}, got one to {job.asked}")
        request = endpoint.read_key(job.read(endpoint.request), job.key)
        job.identity = endpoint.identity(request)
        if self._joins(job):
            return None
        known = self._replies.find(job.identity)
        if known is not None:
            return known
        call = Call(request.id, budget_s=job.budget_s(), waiting=self._queue.qsize, publish=self._board.publish)
        job.compute = partial(endpoint.handler, endpoint.prepare(request), call)
        with self._lock:
            if self._stopping:
                raise UnavailableError(f"{self.address.worker}: the worker is stopping")
            if endpoint.unique_ids and any(other.id == request.id for other in self._jobs.values()):
                raise RequestError(f"id: expected one that is not in progress, got {request.id}")
            self._jobs[job] = call
            waiting = self._apart if endpoint.apart else self._queue
            try:
                waiting.put_nowait(job)
            except queue.Full:
                del self._jobs[job]
                raise BusyError(f"{self.address.worker}: {waiting.maxsize} requests are waiting already") from None
        return None

    def _joins(self, job: Job) -> bool:
        """Return whether the same request is in progress; then its answer goes to this query as well."""
        if job.identity is None:
            return False
        with self._lock:
            for other in self._jobs:
                if other.identity == job.identity:
                    if len(other.followers) == MOST_FOLLOWERS:
                        raise BusyError(f"{self.address.worker}: {MOST_FOLLOWERS} others wait for this answer already")
                    other.followers.append(job)
                    return True
        return False

    def _work(self, waiting: Waiting) -> None:
        while (job := waiting.get()) is not None:
            call = self._jobs.get(job)
            if call is None:
                continue
            try:
                outcome = self._compute(job, call)
            except Exception as error:
                log.exception("%s: request %s was lost", self.address.worker, call.id)
                outcome = ModelError(f"{self.address.worker}: {_brief(error)}")
            try:
                self._end(job, outcome)
            except Exception:
                log.exception("%s: request %s could not be ended", self.address.worker, call.id)

    def _compute(self, job: Job, call: Call) -> Reply | FrugalError:
        known = self._replies.find(job.identity)
        if known is not None:
            return known
        if call.cancelled():
            return CancelledError("the request was taken back before it was computed")
        if call.remaining() <= 0:
            return ExpiredError(f"expected to begin within the budget, got to it {-call.remaining():.3f} s too late")
        if job.compute is None:
            raise AssertionError("only admitted jobs are queued")
        job.begun = time.monotonic()
        try:
            reply = job.compute()
            if not isinstance(reply, Reply):
                raise TypeError(f"expected the handler to return a reply, got {type(reply).__name__}")
        except FrugalError as error:
            failure = error
        except Exception as error:
            log.exception("%s: request %s failed", self.address.worker, call.id)
            failure = ModelError(f"{self.address.worker}: {_brief(error)}")
        else:
            self._replies.keep(job.identity, reply)
            return reply
        if call.has_published:
            call.publish(Progress(kind="failed", error=ErrorReply.of(failure)))
        return failure

    def _end(self, job: Job, outcome: Reply | FrugalError) -> None:
        if not job.claim():
            return
        with self._lock:
            call = self._jobs.pop(job, None)
        asked = (job, *job.followers)
        try:
            answers = [one.encode(_message(outcome)) for one in asked]
        except Exception as error:
            log.exception("%s: an answer could not be written", self.address.worker)
            outcome = ModelError(f"{self.address.worker}: expected an answer that can be sent: {_brief(error)}")
            answers = [one.encode(_message(outcome)) for one in asked]
        with self._lock:
            if isinstance(outcome, Reply):
                self._served += 1
            elif isinstance(outcome, ModelError):
                self._failed += 1
            else:
                self._refused += 1
        for one, answer in zip(asked, answers, strict=True):
            one.answer_bytes(*answer, is_error=isinstance(outcome, FrugalError))
        if call is not None:
            self._board.end(call.id)

    def _cancel(self, query: zenoh.Query) -> None:
        request_id = str(query.key_expr).rpartition("/")[2]
        job = Job(query, self.address.key(f"cancel/{request_id}"))
        try:
            check_name("id", request_id)
        except RequestError as error:
            job.answer(ErrorReply.of(error), is_error=True)
            return
        with self._lock:
            found = {job: call for job, call in self._jobs.items() if call.id == request_id}
        for waiting, call in found.items():
            call.cancel()
            if waiting.begun is None:
                self._end(waiting, CancelledError("the request was taken back before it was computed"))
        job.answer(CancelReply(id=request_id, found=bool(found)))

    def _tell(self, key: str, answer: Callable[[], BaseModel], query: zenoh.Query) -> None:
        Job(query, key).answer(answer())

    def _tell_metrics(self, query: zenoh.Query) -> None:
        text = exposition(self.address, self.health())
        Job(query, self.address.key("metrics")).answer_bytes(text.encode(), ENCODING)


def _message(outcome: Reply | FrugalError) -> Reply:
    return outcome if isinstance(outcome, Reply) else ErrorReply.of(outcome)


def _brief(error: Exception) -> str:
    text = str(error).partition("\n")[0]
    return f"{type(error).__name__}: {text[:200]}" if text else type(error).__name__
