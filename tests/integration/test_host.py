"""Hosts in this process, on sessions of their own: who is answered, and what."""

import threading
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor, as_completed
from contextlib import ExitStack
from typing import Any

import pytest
from conftest import START_S

from common.domain.errors import BusyError, FrugalError, ModelError, RequestError
from common.wire.call import Call
from common.wire.directory import Directory
from common.wire.endpoint import Alias, Endpoint
from common.wire.host import MOST_FOLLOWERS, Host
from common.wire.keys import Address, alias
from common.wire.messages import CancelReply, Card, Health, Reply, Request
from common.wire.query import ask
from common.wire.session import Session, open_session
from common.wire.settings import WireSettings

Serve = Callable[..., Address]


class Strange(Reply):
    """A reply that only its own process can hold."""

    thing: Any


@pytest.fixture
def serve(settings: WireSettings, session: Session) -> Iterator[Serve]:
    """Return what starts an orchestrator of a task and returns its address once it can be reached."""
    with ExitStack() as stack:

        def serve_one(endpoint: Endpoint, *, task: str = "plating") -> Address:
            card = Card(task=task, role="orchestrator", model=None, instance=task, version="1")
            host = Host(stack.enter_context(open_session(settings)), card, [endpoint])
            stack.callback(host.stop, grace_s=0)
            host.start()
            directory = Directory(session, task=task)
            stack.callback(directory.close)
            return directory.wait_for("orchestrator", timeout_s=START_S)[0].address

        yield serve_one


def naming(task: str) -> Endpoint:
    """Return an endpoint whose answer names the task that it serves, on the keys of an orchestrator."""

    def handle(request: Request, call: Call) -> CancelReply:
        return CancelReply(id=task, found=True)

    aliases = (Alias(alias(task, "optimize")), Alias(alias("*", "optimize"), complete=False))
    return Endpoint("optimize", Request, handle, aliases=aliases)


def test_each_task_s_queries_go_to_its_own_orchestrator(session: Session, serve: Serve):
    tasks = ("plating", "cooking")
    for task in tasks:
        serve(naming(task), task=task)
    for _ in range(10):
        for task in tasks:
            replies = list(session.get(alias(task, "optimize"), payload=b"{}", timeout=20))
            assert [reply.ok and task in reply.ok.payload.to_string() for reply in replies] == [True]


@pytest.mark.parametrize("tasks", [("plating",), ("plating", "cooking")])
def test_who_asks_for_a_task_that_nobody_serves_is_told_which_ones_are(
    session: Session, serve: Serve, tasks: tuple[str, ...]
):
    for task in tasks:
        serve(naming(task), task=task)
    with pytest.raises(RequestError, match=r"task: expected (plating|cooking), got frugal/@v1/sewing/optimize"):
        ask(session, alias("sewing", "optimize"), Request(), CancelReply, timeout_s=20)


def test_an_answer_that_cannot_be_written_is_the_model_s_error_and_the_worker_serves_on(session: Session, serve: Serve):
    def handle(request: Request, call: Call) -> Reply:
        return Strange(thing=object()) if request.id == "strange" else CancelReply(id=call.id, found=True)

    address = serve(Endpoint("optimize", Request, handle, identity=lambda request: request.id))
    for _ in range(2):
        with pytest.raises(ModelError, match="expected an answer that can be sent: TypeError"):
            ask(session, address.key("optimize"), Request(id="strange"), CancelReply, timeout_s=20)
    assert ask(session, address.key("optimize"), Request(id="good"), CancelReply, timeout_s=20).id == "good"
    health = ask(session, address.key("health"), None, Health, timeout_s=20)
    assert (health.failed, health.served, health.in_progress) == (2, 1, 0)


@pytest.mark.parametrize("failure", [None, ModelError("it diverged")])
def test_a_request_sent_again_gets_the_first_one_s_answer_and_one_too_many_is_busy(
    session: Session, serve: Serve, failure: FrugalError | None
):
    computed, may_end = [], threading.Event()

    def handle(request: Request, call: Call) -> CancelReply:
        computed.append(call.id)
        may_end.wait(60)
        if failure is not None:
            raise failure
        return CancelReply(id=call.id, found=True)

    def outcome() -> str:
        try:
            return ask(session, address.key("optimize"), request, CancelReply, timeout_s=60).id
        except FrugalError as error:
            return f"{type(error).__name__}: {error}"

    request = Request(id="again")
    address = serve(Endpoint("optimize", Request, handle, identity=lambda request: request.id, unique_ids=True))
    with ThreadPoolExecutor(MOST_FOLLOWERS + 2) as pool:
        answers = as_completed([pool.submit(outcome) for _ in range(MOST_FOLLOWERS + 2)], timeout=60)
        first = next(answers).result()
        may_end.set()
        others = [answer.result() for answer in answers]
    assert first == f"{BusyError.__name__}: orchestrator/plating: 8 others wait for this answer already"
    assert others == ["again" if failure is None else "ModelError: it diverged"] * (MOST_FOLLOWERS + 1)
    assert computed == ["again"]
