"""Promotion: a version of an MDE's weights becomes the active one, and the workers that are alive take it over."""

import time
from collections.abc import Callable
from dataclasses import dataclass

from common.domain.errors import FrugalError, TimedOutError, UnavailableError
from common.storage.registry import CARD, TENSORS, Registry, Version
from common.wire.client import WorkerStatus, list_workers
from common.wire.keys import Address
from common.wire.messages import Health, LoadReply, LoadRequest
from common.wire.query import NoReplyError, ask
from common.wire.session import Session

LOAD_S = 30.0
"""Time that a worker gets to take weights over [s]."""
PROBE_S = 2.0
"""Time that a health key gets to answer before it is asked again [s]."""
PREFIX = "mde_"
"""Weights of the MDE of a model are named ``mde_<model>``."""


@dataclass(frozen=True)
class Promotion:
    """Changes the active version of one name, and tells the workers.

    Attributes:
        registry: The versions.
        name: Whose weights.
        session: Where the workers are; None: there is no router, and only the registry changes.
        say: Called with a line about every worker.
    """

    registry: Registry
    name: str
    session: Session | None
    say: Callable[[str], None]

    def promote(self, version: str) -> Version:
        """Make a version the active one everywhere, or nowhere: the first worker that refuses it undoes all.

        Workers that start meanwhile serve it, or are told as well.

        Raises:
            RequestError: There is no such version.
            FrugalError: A worker did not take it over; those that had are back at the version before.
        """
        before = next((one for one in self.registry.versions(self.name) if one.is_active), None)
        found = self.registry.promote(self.name, version)
        try:
            self._spread(found)
        except (FrugalError, KeyboardInterrupt):
            if before is None or before.version != version:
                self.registry.take_back(self.name)
                self._take_back(found, before)
            raise
        return found

    def rollback(self) -> Version:
        """Make the version before the active one everywhere.

        Raises:
            RequestError: There is none.
            FrugalError: A worker did not take it over; the version before is active nevertheless.
        """
        found = self.registry.rollback(self.name)
        self._spread(found)
        return found

    def wait_for_worker(self, *, timeout_s: float) -> None:
        """Wait until a worker is alive that takes the weights over.

        Raises:
            UnavailableError: None came in time [s].
        """
        deadline = time.monotonic() + timeout_s
        while not self._workers():
            if time.monotonic() > deadline:
                raise UnavailableError(f"expected a live MDE of {self._model} within {timeout_s:g} s, got none")
            time.sleep(0.1)

    def _spread(self, version: Version) -> None:
        """Give a version to every worker that does not serve it, those that come meanwhile too.

        Raises:
            FrugalError: A worker did not take it over; the others were not asked.
        """
        if not self._kind.startswith(PREFIX):
            self.say(f"{self.name}: workers take it over when they start again")
        elif self.session is None:
            self.say("no router: workers take it over when they start again")
        else:
            told: set[Address] = set()
            request = _request(version)
            while left := [one for one in self._workers() if one.address not in told]:
                for worker in left:
                    told.add(worker.address)
                    if _weights(worker) == version.card["sha256"]:
                        self.say(f"{worker.address.worker}: {version.version} already")
                    else:
                        self._give(self.session, worker.address, request)
            if not told:
                self.say(f"no live worker of the MDE of {self._model}: the next one that starts begins with it")

    def _give(self, session: Session, address: Address, request: LoadRequest) -> None:
        try:
            reply = ask(session, address.key("load"), request, LoadReply, timeout_s=LOAD_S)
        except NoReplyError:
            if is_gone(session, address):
                self.say(f"{address.worker}: gone")
                return
            raise UnavailableError(
                f"{address.worker}: expected it to take weights over, got no reply: it cannot, or access was denied"
            ) from None
        except FrugalError as error:
            raise type(error)(f"{address.worker}: {error}") from None
        self.say(f"{address.worker}: {reply.version}, before {reply.previous}")

    def _take_back(self, version: Version, before: Version | None) -> None:
        """Give the version before to every worker that serves ``version``; of one that fails the reason is told."""
        if self.session is None:
            return
        for worker in self._workers():
            if _weights(worker) != version.card["sha256"]:
                continue
            if before is None:
                self.say(f"{worker.address.worker}: still {version.version}, for there is no version before")
                continue
            try:
                self._give(self.session, worker.address, _request(before))
            except FrugalError as error:
                self.say(f"still {version.version}: {error}")

    def _workers(self) -> list[WorkerStatus]:
        if self.session is None:
            return []
        return [one for one in list_workers(self.session) if self._is_concerned(one)]

    def _is_concerned(self, worker: WorkerStatus) -> bool:
        """Return whether a worker serves a version of this name, by the SHA-256 on its card.

        One that serves what no name has, from another folder or another machine's, counts to the name in one part.
        """
        if worker.address.role != "mde" or f"{PREFIX}{worker.address.model}" != self._kind:
            return False
        owners = self.registry.owners(self._kind, _weights(worker))
        return self.name in owners or not (owners or "/" in self.name)

    @property
    def _kind(self) -> str:
        return self.name.rpartition("/")[2]

    @property
    def _model(self) -> str:
        return self._kind.removeprefix(PREFIX)


def _weights(worker: WorkerStatus) -> str | None:
    return None if worker.card is None else worker.card.weights


def is_gone(session: Session, address: Address) -> bool:
    """Return whether nobody answers for a worker; the token of a process that has just ended may still be there.

    It is asked again and again: no end is told of a question that the process took with it.

    Raises:
        TimedOutError: There was neither an answer nor an end in `LOAD_S`.
    """
    deadline = time.monotonic() + LOAD_S
    while True:
        try:
            ask(session, address.key("health"), None, Health, timeout_s=PROBE_S)
        except NoReplyError:
            return True
        except TimedOutError:
            if time.monotonic() >= deadline:
                raise
        else:
            return False


def _request(version: Version) -> LoadRequest:
    return LoadRequest(card=(version.folder / CARD).read_bytes(), tensors=(version.folder / TENSORS).read_bytes())
