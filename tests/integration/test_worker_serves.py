"""What workers in processes of their own answer over a real router."""

import json
import threading
import time
from concurrent.futures import ThreadPoolExecutor

import numpy as np
import pytest
import zenoh
from conftest import START_S, Start

from common.domain.errors import BusyError, CancelledError, ExpiredError, TimedOutError, UnknownStateError
from common.wire.client import list_workers
from common.wire.codec import encode
from common.wire.directory import Directory
from common.wire.dispatch import Limits
from common.wire.keys import Address
from common.wire.messages import CancelReply, Health, PredictReply, PredictRequest
from common.wire.query import ask
from common.wire.remote import RemoteEstimator, RemoteModel
from common.wire.session import Session
from tests.fakes import Radius, Tilted, make_state

STATE = make_state(bodies=True)
ACTIONS = np.array([[0.01, 0.02], [0.0, -0.03]])
LIMITS = Limits(timeout_s=30.0)


def request() -> PredictRequest:
    return PredictRequest.of(STATE, ACTIONS, content=True)


def send(session: Session, address: Address) -> None:
    """Send a request and do not wait for its answer."""
    payload, encoding = encode(request())
    session.get(address.key("predict"), lambda _: None, payload=payload, encoding=encoding, timeout=600)


def wait_for_load(session: Session, address: Address, *, computing: int, waiting: int) -> None:
    while True:
        health = ask(session, address.key("health"), None, Health, timeout_s=20)
        if (health.in_progress, health.queue_length) == (computing, waiting):
            return
        time.sleep(0.01)


def test_a_remote_model_predicts_what_the_local_one_does(directory: Directory, start: Start):
    start("good", "tilted", "a")
    directory.wait_for("model", "tilted", timeout_s=START_S)
    remote = RemoteModel(directory, "tilted", limits=LIMITS)
    found, expected = remote.predict(STATE, ACTIONS), Tilted().predict(STATE, ACTIONS)
    np.testing.assert_array_equal(found.heights, expected.heights)
    assert (found.model, found.version, found.instance, found.events) == ("tilted", "1", "a", ())
    assert found.compute_s is not None
    assert remote.largest_batch == Tilted.largest_batch


def test_a_remote_estimator_estimates_what_the_local_one_does(directory: Directory, start: Start):
    start("mde", "tilted", "a")
    directory.wait_for("mde", "tilted", timeout_s=START_S)
    found = RemoteEstimator(directory, "tilted", limits=LIMITS).estimate(STATE, ACTIONS)
    expected = Radius().estimate(STATE, ACTIONS)
    for name in ("mean", "upper", "familiar"):
        np.testing.assert_array_equal(getattr(found, name), getattr(expected, name))
    assert found.instance == "a"


def test_a_state_travels_once_and_is_asked_for_where_it_is_unknown(
    session: Session, directory: Directory, start: Start
):
    start("good", "tilted", "a")
    directory.wait_for("model", "tilted", timeout_s=START_S)
    key = Address("plating", "model", "tilted", "a").key("predict")
    named = PredictRequest.of(STATE, ACTIONS, content=False)
    with pytest.raises(UnknownStateError, match="send it as 'content'"):
        ask(session, key, named, PredictReply, timeout_s=20)
    ask(session, key, named.carrying(STATE), PredictReply, timeout_s=20)
    again = PredictRequest.of(STATE, ACTIONS, content=False)
    assert ask(session, key, again, PredictReply, timeout_s=20).heights.shape == (2, *STATE.grid.shape)


def test_a_worker_that_was_replaced_gets_the_state_again(directory: Directory, start: Start):
    first = start("good", "tilted", "a")
    directory.wait_for("model", "tilted", timeout_s=START_S)
    remote = RemoteModel(directory, "tilted", limits=LIMITS)
    remote.predict(STATE, ACTIONS)
    first.kill()
    start("good", "tilted", "b")
    directory.wait_for("model", "tilted", timeout_s=START_S)
    while {worker.address.instance for worker in directory.workers("model")} != {"b"}:
        directory.wait_for_change(0.1)
    assert remote.predict(STATE, ACTIONS).instance == "b"


def test_a_retry_with_the_same_id_is_not_computed_again(session: Session, directory: Directory, start: Start):
    start("slow", "tilted", "a")
    directory.wait_for("model", "tilted", timeout_s=START_S)
    address = Address("plating", "model", "tilted", "a")
    repeated = request()
    first = ask(session, address.key("predict"), repeated, PredictReply, timeout_s=20)
    second = ask(session, address.key("predict"), repeated, PredictReply, timeout_s=20)
    assert second == first
    health = ask(session, address.key("health"), None, Health, timeout_s=20)
    assert (health.served, health.cost[0].count) == (2, 1)


def test_a_full_queue_is_busy(session: Session, directory: Directory, start: Start):
    start("stuck", "tilted", "a", 1)
    directory.wait_for("model", "tilted", timeout_s=START_S)
    address = Address("plating", "model", "tilted", "a")
    for computing, waiting in ((1, 0), (1, 1)):
        send(session, address)
        wait_for_load(session, address, computing=computing, waiting=waiting)
    with pytest.raises(BusyError, match="tilted/a: 1 requests are waiting already"):
        ask(session, address.key("predict"), request(), PredictReply, timeout_s=20)


def test_busy_workers_are_asked_again_until_all_is_done(directory: Directory, start: Start):
    start("slow", "tilted", "a", 1)
    directory.wait_for("model", "tilted", timeout_s=START_S)
    remote = RemoteModel(directory, "tilted", limits=LIMITS)
    with ThreadPoolExecutor(6) as pool:
        found = list(pool.map(lambda number: remote.predict(STATE, ACTIONS * number), range(6)))
    assert len(found) == 6
    assert {event.kind for one in found for event in one.events} <= {"busy"}


def test_calls_are_spread_over_the_replicas(directory: Directory, start: Start):
    for instance in ("a", "b", "c"):
        start("slow", "tilted", instance)
    directory.wait_for("model", "tilted", count=3, timeout_s=START_S)
    remote = RemoteModel(directory, "tilted", limits=LIMITS)
    with ThreadPoolExecutor(3) as pool:
        found = list(pool.map(lambda number: remote.predict(STATE, ACTIONS * number).instance, range(9)))
    assert set(found) == {"a", "b", "c"}


def test_a_reply_that_does_not_come_in_time_is_timed_out(session: Session, directory: Directory, start: Start):
    start("stuck", "tilted", "a")
    directory.wait_for("model", "tilted", timeout_s=START_S)
    address = Address("plating", "model", "tilted", "a")
    with pytest.raises(TimedOutError, match=r"expected a reply within 0\.2 s"):
        ask(session, address.key("predict"), request(), PredictReply, timeout_s=0.2)


def test_an_expired_budget_is_answered_so(session: Session, directory: Directory, start: Start):
    start("good", "tilted", "a")
    directory.wait_for("model", "tilted", timeout_s=START_S)
    address = Address("plating", "model", "tilted", "a")
    payload, encoding = encode(request())
    replies = list(session.get(address.key("predict"), payload=payload, encoding=encoding, attachment="-0.5"))
    assert b"expired" in replies[0].err.payload.to_bytes()
    assert ExpiredError.code == "expired"
    assert ask(session, address.key("health"), None, Health, timeout_s=20).served == 0


def test_card_health_and_metrics_are_answered_while_computing(session: Session, directory: Directory, start: Start):
    start("stuck", "tilted", "a")
    directory.wait_for("model", "tilted", timeout_s=START_S)
    address = Address("plating", "model", "tilted", "a")
    send(session, address)
    wait_for_load(session, address, computing=1, waiting=0)
    status = list_workers(session, task="plating", timeout_s=20)[0]
    assert status.card is not None
    assert status.health is not None
    assert status.health.computing_s is not None
    metrics = next(iter(session.get(address.key("metrics")))).ok.payload.to_string()
    assert 'frugal_in_progress{task="plating",role="model",model="tilted",instance="a"} 1' in metrics


def test_a_waiting_request_is_cancelled_at_once(session: Session, directory: Directory, start: Start):
    start("stuck", "tilted", "a")
    directory.wait_for("model", "tilted", timeout_s=START_S)
    address = Address("plating", "model", "tilted", "a")
    send(session, address)
    wait_for_load(session, address, computing=1, waiting=0)
    unwanted = request()
    with ThreadPoolExecutor(1) as pool:
        future = pool.submit(ask, session, address.key("predict"), unwanted, PredictReply, timeout_s=60)
        wait_for_load(session, address, computing=1, waiting=1)
        assert ask(session, address.key(f"cancel/{unwanted.id}"), None, CancelReply, timeout_s=20).found
        with pytest.raises(CancelledError, match="taken back before it was computed"):
            future.result(timeout=60)
    assert not ask(session, address.key("cancel/nobody"), None, CancelReply, timeout_s=20).found


def test_a_call_that_is_taken_back_returns_at_once(directory: Directory, start: Start):
    start("stuck", "tilted", "a")
    directory.wait_for("model", "tilted", timeout_s=START_S)
    taken_back = threading.Event()
    limits = Limits(timeout_s=20.0, cancelled=taken_back.is_set)
    remote = RemoteModel(directory, "tilted", limits=limits)
    with ThreadPoolExecutor(1) as pool:
        future = pool.submit(remote.predict, STATE, ACTIONS)
        taken_back.set()
        with pytest.raises(CancelledError):
            future.result(timeout=60)


def test_a_plain_client_asks_in_json_and_is_answered_in_json(session: Session, directory: Directory, start: Start):
    start("good", "tilted", "a")
    directory.wait_for("model", "tilted", timeout_s=START_S)
    payload = encode(request(), form="json")[0]
    reply = next(iter(session.get("frugal/@v1/plating/model/tilted/a/predict", payload=payload)))
    assert reply.ok.encoding == zenoh.Encoding.APPLICATION_JSON
    found = PredictReply.model_validate(json.loads(reply.ok.payload.to_string()))
    np.testing.assert_array_equal(found.heights.values(), Tilted().predict(STATE, ACTIONS).heights)
    card = next(iter(session.get("frugal/@v1/plating/model/tilted/*/card"))).ok.payload.to_string()
    assert json.loads(card)["instance"] == "a"


def test_a_request_sent_again_while_it_is_computed_gets_the_same_answer(
    session: Session, directory: Directory, start: Start
):
    start("slow", "tilted", "a")
    directory.wait_for("model", "tilted", timeout_s=START_S)
    address, repeated = Address("plating", "model", "tilted", "a"), request()
    with ThreadPoolExecutor(3) as pool:
        calls = [
            pool.submit(ask, session, address.key("predict"), repeated, PredictReply, timeout_s=60) for _ in range(3)
        ]
        replies = [call.result(timeout=60) for call in calls]
    assert replies[0] == replies[1] == replies[2]
    assert ask(session, address.key("health"), None, Health, timeout_s=20).cost[0].count == 1
