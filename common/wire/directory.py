"""Who is alive: follows liveliness tokens, keeps cards, and chooses the least loaded worker."""

import threading
import time
from collections import OrderedDict
from collections.abc import Callable, Collection
from contextlib import suppress
from dataclasses import dataclass, field
from functools import partial

import zenoh

from common.domain.errors import FrugalError, RequestError, UnavailableError
from common.domain.grid import Grid
from common.domain.model import Event
from common.wire.codec import decode
from common.wire.cost import CostMeter
from common.wire.keys import Address, Role, every_live, every_worker, parse_address
from common.wire.messages import Card, Health
from common.wire.query import NoReplyError, ask
from common.wire.session import is_connected
from common.wire.state import GridMessage

SUSPECT_S = 10.0
LOAD_IS_FRESH_S = 1.0
CARD_TIMEOUT_S = 1.0
LOOK_S = 1.0
PROBE_TIMEOUT_S = 1.0
HEARD_S = 1.0
STATES_REMEMBERED = 64


@dataclass(frozen=True)
class Worker:
    """A live worker as its observer sees it.

    Attributes:
        address: Where it is.
        card: What it said about itself; None until it answered.
        is_suspect: Whether it failed lately and is asked only if nobody else is there.
        in_flight: Calls of this process that wait for it.
    """

    address: Address
    card: Card | None
    is_suspect: bool
    in_flight: int


@dataclass
class _Entry:
    address: Address
    card: Card | None = None
    asked_card: float = -1e9
    in_flight: int = 0
    calls: int = 0
    load: int = 0
    load_seen: float = -1e9
    suspect_until: float = -1e9
    states: OrderedDict[str, None] = field(default_factory=OrderedDict)


class Directory:
    """The live workers of one task. Safe to use from several threads."""

    def __init__(self, session: zenoh.Session, *, task: str) -> None:
        self.session = session
        self.task = task
        self._entries: dict[Address, _Entry] = {}
        self._meters: dict[tuple[Role, str | None], CostMeter] = {}
        self._lost = -1e9
        self._looked = -1e9
        self._forgotten: dict[Address, float] = {}
        self._callbacks: list[Callable[[Event], None]] = []
        self._changed = threading.Condition(threading.RLock())
        self._subscriber = session.liveliness().declare_subscriber(every_live(task), self._on_token, history=True)

    def close(self) -> None:
        """Stop following."""
        self._subscriber.undeclare()

    def on_change(self, callback: Callable[[Event], None]) -> None:
        """Call back with an event ``joined`` or ``left`` for every worker that comes or goes; it must not block."""
        with self._changed:
            self._callbacks.append(callback)

    def workers(self, role: Role | None = None, model: str | None = None) -> tuple[Worker, ...]:
        """Return the live workers, all or those of one role or model, in the order of their addresses.

        Cards that did not come are asked for again.
        """
        self._fetch_missing_cards()
        return self._seen(role, model)

    def _seen(self, role: Role | None, model: str | None) -> tuple[Worker, ...]:
        now = time.monotonic()
        with self._changed:
            found = [
                Worker(entry.address, entry.card, entry.suspect_until > now, entry.in_flight)
                for entry in self._entries.values()
                if role in (None, entry.address.role) and model in (None, entry.address.model)
            ]
        return tuple(sorted(found, key=lambda worker: worker.address.prefix))

    def wait_for(
        self, role: Role, model: str | None = None, *, count: int = 1, timeout_s: float = 1.5
    ) -> tuple[Worker, ...]:
        """Return the live workers of a role once ``count`` of them have shown their cards.

        Raises:
            UnavailableError: Fewer came in time; the text names what is missing.
        """
        deadline = time.monotonic() + timeout_s
        while True:
            self.look()
            self._fetch_missing_cards()
            with self._changed:
                found = tuple(worker for worker in self._seen(role, model) if worker.card is not None)
                if len(found) >= count:
                    return found
                left = deadline - time.monotonic()
                if left <= 0:
                    break
                self._changed.wait(min(left, 0.1))
        raise UnavailableError(f"expected {count} live {describe(role, model)} of {self.task}, got {len(found)}")

    def wait_for_change(self, timeout_s: float) -> None:
        """Wait until a worker comes, goes or shows its card, or the time is over [s]."""
        with self._changed:
            self._changed.wait(timeout_s)

    def look(self) -> None:
        """Ask everybody for a card, at most once in `LOOK_S`, and add in the background who was not known.

        Zenoh now and then tells a subscriber no tokens. A worker that was forgotten lately comes back as a suspect.
        """
        began = time.monotonic()
        with self._changed:
            if began - self._looked < LOOK_S:
                return
            self._looked = began
            self._forgotten = {one: since for one, since in self._forgotten.items() if began - since < SUSPECT_S}
        with suppress(zenoh.ZError):
            self.session.get(
                every_worker(self.task, "card"),
                zenoh.handlers.Callback(partial(self._on_card, began), indirect=True),
                target=zenoh.QueryTarget.ALL,
                consolidation=zenoh.ConsolidationMode.NONE,
                timeout=CARD_TIMEOUT_S,
            )

    def claim(
        self, role: Role, model: str | None, *, grid: Grid | None = None, exclude: Collection[Address] = ()
    ) -> Address | None:
        """Return the least loaded live worker that is not excluded, a suspect only if there is no other.

        With ``grid`` only those count that take it, or whose card did not come yet. The worker counts as called until
        `release`.
        """
        now = time.monotonic()
        with self._changed:
            found = [
                entry
                for entry in self._entries.values()
                if (entry.address.role, entry.address.model) == (role, model)
                and entry.address not in exclude
                and _takes(entry.card, grid)
            ]
            best = min(found, key=lambda entry: _rank(entry, now), default=None)
            if best is None:
                return None
            best.in_flight += 1
            best.calls += 1
            return best.address

    def release(self, address: Address) -> None:
        """End a call that began with `claim`."""
        with self._changed:
            entry = self._entries.get(address)
            if entry is not None:
                entry.in_flight = max(0, entry.in_flight - 1)

    def holds(self, address: Address, digest: str) -> bool:
        """Return whether a worker was sent this state."""
        with self._changed:
            entry = self._entries.get(address)
            return entry is not None and digest in entry.states

    def record(
        self, address: Address, *, digest: str, batch: int, compute_s: float, load: int, version: str | None = None
    ) -> None:
        """Note a good answer: the worker holds the state, is no suspect, took that long and has so many waiting.

        If another version gave it than the worker's card tells, the card is asked for again.
        """
        with self._changed:
            self._meters.setdefault((address.role, address.model), CostMeter()).record(batch, compute_s)
            entry = self._entries.get(address)
            if entry is None:
                return
            entry.suspect_until = -1e9
            entry.load, entry.load_seen = load, time.monotonic()
            entry.states[digest] = None
            entry.states.move_to_end(digest)
            if len(entry.states) > STATES_REMEMBERED:
                entry.states.popitem(last=False)
            known = version if entry.card is None else entry.card.version
            if version in (None, known) or time.monotonic() - entry.asked_card < CARD_TIMEOUT_S:
                return
            entry.asked_card = time.monotonic()
        self._fetch_card(address)

    def suspect(self, address: Address) -> None:
        """Avoid a worker for `SUSPECT_S`, unless nobody else is there."""
        with self._changed:
            entry = self._entries.get(address)
            if entry is not None:
                entry.suspect_until = time.monotonic() + SUSPECT_S

    def answers(self, address: Address) -> bool:
        """Return whether a worker gave a good answer in the last `HEARD_S`, to any call, or answers its health key.

        Under many calls the answer of the health key is late; it needs not be asked while others come.
        """
        with self._changed:
            entry = self._entries.get(address)
            heard = entry is not None and time.monotonic() - entry.load_seen < HEARD_S
        return heard or self.probe(address)

    def probe(self, address: Address) -> bool:
        """Return whether a worker still answers its health key.

        One that is late becomes a suspect. One whose key nobody serves is forgotten until its token appears again: its
        process is gone, even if the token's end was not told.
        """
        try:
            ask(self.session, address.key("health"), None, Health, timeout_s=PROBE_TIMEOUT_S)
        except NoReplyError:
            if not self.is_partitioned():
                self._forget(address)
            return False
        except FrugalError:
            self.suspect(address)
            return False
        return True

    def cost_s(self, role: Role, model: str | None, *, batch: int = 1) -> float | None:
        """Return the median time of a computation, measured here, else what the workers' cards say [s]."""
        with self._changed:
            meter = self._meters.get((role, model))
            own = meter and meter.median_s(batch)
            if own is not None:
                return own
            told = [
                cost.p50_s
                for worker in self._seen(role, model)
                if worker.card is not None
                for cost in worker.card.cost
                if cost.batch == batch
            ]
        return min(told, default=None)

    def action_s(self, role: Role, model: str | None) -> float | None:
        """Return what one action costs in the smallest batches that were measured here, else by workers' cards [s]."""
        with self._changed:
            meter = self._meters.get((role, model))
            workers = self._seen(role, model)
            costs = meter.costs() if meter is not None else ()
            costs = costs or tuple(cost for one in workers if one.card is not None for cost in one.card.cost)
        smallest = min((cost.batch for cost in costs), default=0)
        return min((cost.p50_s / cost.batch for cost in costs if cost.batch == smallest), default=None)

    def is_partitioned(self) -> bool:
        """Return whether this process has lost its router, so that silence says nothing about the workers."""
        if is_connected(self.session):
            return False
        self._lost = time.monotonic()
        return True

    def was_partitioned(self, within_s: float) -> bool:
        """Return whether the router was lost in the last ``within_s`` [s]: workers need some time to come back."""
        return self.is_partitioned() or time.monotonic() - self._lost < within_s

    def _on_token(self, sample: zenoh.Sample) -> None:
        try:
            address, _ = parse_address(str(sample.key_expr))
        except RequestError:
            return
        if sample.kind == zenoh.SampleKind.PUT:
            self._add(address)
        else:
            self.is_partitioned()
            self._forget(address)

    def _add(self, address: Address, *, seen: float | None = None) -> None:
        """Add a worker whose token came, or whose card was asked for at ``seen`` on the monotonic clock [s]."""
        with self._changed:
            known = self._entries.get(address)
            gone = self._forgotten.get(address, -1e9)
            if seen is not None and (known is not None or seen <= gone):
                return
            if known is None:
                self._entries[address] = _Entry(address, suspect_until=-1e9 if seen is None else gone + SUSPECT_S)
            self._forgotten.pop(address, None)
            self._entries[address].asked_card = time.monotonic()
            self._changed.notify_all()
        if seen is None:
            self._fetch_card(address)
        if known is None:
            self._tell(Event("joined", address.worker, f"{describe(address.role, address.model)} is alive"))

    def _forget(self, address: Address) -> None:
        with self._changed:
            was_known = self._entries.pop(address, None) is not None
            self._forgotten[address] = time.monotonic()
            self._changed.notify_all()
        if was_known:
            self._tell(Event("left", address.worker, f"{describe(address.role, address.model)} is gone"))

    def _tell(self, event: Event) -> None:
        with self._changed:
            callbacks = tuple(self._callbacks)
        for callback in callbacks:
            callback(event)

    def _fetch_missing_cards(self) -> None:
        now = time.monotonic()
        with self._changed:
            missing = [
                one for one in self._entries.values() if one.card is None and now - one.asked_card > CARD_TIMEOUT_S
            ]
            for entry in missing:
                entry.asked_card = now
        for entry in missing:
            self._fetch_card(entry.address)

    def _fetch_card(self, address: Address) -> None:
        callback = zenoh.handlers.Callback(partial(self._on_card, None), indirect=True)
        with suppress(zenoh.ZError):
            self.session.get(address.key("card"), callback, timeout=CARD_TIMEOUT_S)

    def _on_card(self, looked: float | None, reply: zenoh.Reply) -> None:
        if reply.ok is None:
            return
        try:
            address, _ = parse_address(str(reply.ok.key_expr))
            card = decode(reply.ok.payload.to_bytes(), str(reply.ok.encoding), Card)
        except RequestError:
            return
        if looked is not None:
            self._add(address, seen=looked)
        with self._changed:
            entry = self._entries.get(address)
            if entry is not None:
                entry.card = card
                self._changed.notify_all()


def describe(role: Role, model: str | None) -> str:
    """Return what a worker is called in messages."""
    return {"model": f"model {model}", "mde": f"MDE of {model}"}.get(role, role)


def _takes(card: Card | None, grid: Grid | None) -> bool:
    return card is None or card.grid is None or grid is None or card.grid == GridMessage.of(grid)


def _rank(entry: _Entry, now: float) -> tuple[bool, int, int, str]:
    load = entry.load if now - entry.load_seen < LOAD_IS_FRESH_S else 0
    return entry.suspect_until > now, max(entry.in_flight, load), entry.calls, entry.address.instance
