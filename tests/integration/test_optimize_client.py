"""A client's side of an optimisation: answer, progress, replay, cancellation, silence."""

import threading
import time
from concurrent.futures import ThreadPoolExecutor

import numpy as np
import pytest
from conftest import START_S, Start

from common.domain.errors import CancelledError, ModelError, RequestError, TimedOutError, UnavailableError
from common.wire.array import Array
from common.wire.client import follow_progress, list_workers, optimize
from common.wire.directory import Directory
from common.wire.messages import Health
from common.wire.optimization import OptimizeRequest, Progress
from common.wire.query import ask
from common.wire.session import Session
from common.wire.state import StateMessage
from tests.fakes import make_state

STATE = make_state()


def make_request(**changes: object) -> OptimizeRequest:
    fields = {"state": StateMessage.of(STATE), "target": Array.of(STATE.scene.heights)}
    return OptimizeRequest.model_validate({**fields, "strategy": "threshold", "evaluations": 5, **changes})


class Steps:
    """Collects progress, and knows when an optimisation is over."""

    def __init__(self) -> None:
        self.seen: list[Progress] = []
        self.over = threading.Event()
        self.begun = threading.Event()

    def __call__(self, step: Progress) -> None:
        self.seen.append(step)
        self.begun.set()
        if step.kind in ("finished", "failed"):
            self.over.set()


@pytest.fixture
def orchestrator(directory: Directory, start: Start) -> Directory:
    start("orchestrator", "none", "o")
    directory.wait_for("orchestrator", timeout_s=START_S)
    return directory


@pytest.mark.usefixtures("orchestrator")
def test_the_answer_and_every_step_come_once_and_in_order(session: Session):
    steps, request = Steps(), make_request()
    reply = optimize(session, request, on_progress=steps, timeout_s=60)
    assert (reply.id, len(reply.trials)) == (request.id, 5)
    np.testing.assert_array_equal(reply.result().heights, STATE.scene.heights)
    assert [step.index for step in steps.seen] == list(range(7))
    assert [step.kind for step in steps.seen] == ["accepted", *["trial"] * 5, "finished"]


@pytest.mark.usefixtures("orchestrator")
def test_a_late_subscriber_gets_every_step_also_after_the_end(session: Session):
    request = make_request()
    optimize(session, request, timeout_s=60)
    steps = Steps()
    with follow_progress(session, steps, request_id=request.id):
        assert steps.over.wait(60)
    assert [step.kind for step in steps.seen] == ["accepted", *["trial"] * 5, "finished"]
    assert [step.index for step in steps.seen] == list(range(7))


@pytest.mark.usefixtures("orchestrator")
def test_a_subscriber_in_the_middle_gets_the_beginning_too(session: Session):
    request, first, second = make_request(evaluations=100), Steps(), Steps()
    with ThreadPoolExecutor(1) as pool:
        future = pool.submit(optimize, session, request, on_progress=first, timeout_s=60)
        assert first.begun.wait(60)
        with follow_progress(session, second, task="plating"):
            future.result(timeout=60)
            assert second.over.wait(60)
    assert [step.index for step in second.seen] == list(range(102))


@pytest.mark.usefixtures("orchestrator")
def test_a_second_run_of_a_request_is_followed_from_its_beginning(session: Session):
    steps, request = Steps(), make_request()
    with follow_progress(session, steps, request_id=request.id):
        for expected in (7, 14):
            optimize(session, request, timeout_s=60)
            deadline = time.monotonic() + 20
            while len(steps.seen) < expected:
                assert time.monotonic() < deadline
                time.sleep(0.02)
    assert [step.index for step in steps.seen] == [*range(7), *range(7)]
    assert len({step.run for step in steps.seen}) == 2


def test_a_cancelled_optimisation_ends_early_at_the_orchestrator(session: Session, orchestrator: Directory):
    request, steps = make_request(evaluations=5000), Steps()
    with pytest.raises(CancelledError):
        optimize(session, request, on_progress=steps, cancelled=steps.begun.is_set, timeout_s=60)
    address = orchestrator.workers("orchestrator")[0].address
    while ask(session, address.key("health"), None, Health, timeout_s=20).in_progress:
        orchestrator.wait_for_change(0.05)


def test_an_optimisation_that_takes_too_long_is_stopped(session: Session, orchestrator: Directory):
    with pytest.raises(TimedOutError):
        optimize(session, make_request(evaluations=5000), timeout_s=0.3)
    address = orchestrator.workers("orchestrator")[0].address
    while ask(session, address.key("health"), None, Health, timeout_s=20).in_progress:
        orchestrator.wait_for_change(0.05)


@pytest.mark.usefixtures("orchestrator")
def test_a_failed_optimisation_says_so_to_caller_and_followers(session: Session):
    steps, request = Steps(), make_request(strategy="raise")
    with pytest.raises(ModelError, match="told to fail"):
        optimize(session, request, timeout_s=60)
    with follow_progress(session, steps, request_id=request.id):
        assert steps.over.wait(60)
    assert steps.seen[-1].error is not None
    assert steps.seen[-1].error.message == "told to fail"


@pytest.mark.usefixtures("orchestrator")
def test_two_optimisations_run_at_once_but_not_under_one_id(session: Session):
    request, steps = make_request(evaluations=200), Steps()
    with ThreadPoolExecutor(1) as pool:
        future = pool.submit(optimize, session, request, on_progress=steps, timeout_s=60)
        assert steps.begun.wait(60)
        with pytest.raises(RequestError, match="id: expected one that is not in progress"):
            optimize(session, make_request(id=request.id), timeout_s=60)
        assert len(optimize(session, make_request(), timeout_s=60).trials) == 5
        assert len(future.result(timeout=60).trials) == 200


def test_without_an_orchestrator_the_error_names_the_key(session: Session):
    with pytest.raises(UnavailableError, match="expected an orchestrator behind frugal/@v1/plating/optimize"):
        optimize(session, make_request(), timeout_s=60)


def test_the_list_of_workers_shows_cards_and_health(session: Session, orchestrator: Directory, start: Start):
    start("good", "tilted", "a")
    orchestrator.wait_for("model", "tilted", timeout_s=START_S)
    found = list_workers(session, timeout_s=20)
    assert [status.address.worker for status in found] == ["tilted/a", "orchestrator/o"]
    assert all(status.card is not None and status.health is not None for status in found)
