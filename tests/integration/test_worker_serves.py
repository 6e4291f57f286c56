"""What workers in processes of their own answer over a real router."""

import json
import threading
import time
from concurrent.futures import ThreadPoolExecutor

import numpy as np
import pytest
import zenoh
from conftest import START_S, Start
from fakes import Radius, Tilted, make_state

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

STATE = make_state(bodies=True)
ACTIONS = np.array([[0.01, 0.02], [0.0, -0.03]])
LIMITS = Limits(timeout_s=20.0)


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
        ask(session, key, named, PredictReply, timeout_s=5)
    ask(session, key, named.carrying(STATE), PredictReply, timeout_s=5)
    again = PredictRequest.of(STATE, ACTIONS, content=False)
    assert ask(session, key, again, PredictReply, timeout_s=5).heights.shape == (2, *STATE.grid.shape)


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
    request = PredictRequest.of(STATE, ACTIONS, content=True)
    first = ask(session, address.key("predict"), request, PredictReply, timeout_s=5)
    second = ask(session, address.key("predict"), request, PredictReply, timeout_s=5)
    assert second == first
    health = ask(session, address.key("health"), None, Health, timeout_s=5)
    assert (health.served, health.cost[0].count) == (2, 1)


def test_a_full_queue_is_busy_and_the_rest_is_answered(session: Session, directory: Directory, start: Start):
    start("slow", "tilted", "a", 1)
    directory.wait_for("model", "tilted", timeout_s=START_S)
    key = Address("plating", "model", "tilted", "a").key("predict")

    def call(number: int) -> bool:
        try:
            ask(session, key, PredictRequest.of(STATE, ACTIONS, content=True), PredictReply, timeout_s=20)
        except BusyError:
            return False
        return True

    with ThreadPoolExecutor(6) as pool:
        answered = list(pool.map(call, range(6)))
    assert 1 <= sum(answered) < 6


def test_busy_workers_are_asked_again_until_all_is_done(directory: Directory, start: Start):
    start("slow", "tilted", "a", 1)
    directory.wait_for("model", "tilted", timeout_s=START_S)
    remote = RemoteModel(directory, "tilted", limits=LIMITS)
    with ThreadPoolExecutor(6) as pool:
        found = list(pool.map(lambda number: remote.predict(STATE, ACTIONS * number), range(6)))
    assert len(found) == 6
    assert {event.kind for one in found for event in one.events} == {"busy"}


def test_calls_are_spread_over_the_replicas(directory: Directory, start: Start):
    for instance in ("a", "b", "c"):
        start("slow", "tilted", instance)
    directory.wait_for("model", "tilted", count=3, timeout_s=START_S)
    remote = RemoteModel(directory, "tilted", limits=LIMITS)
    with ThreadPoolExecutor(3) as pool:
        found = list(pool.map(lambda number: remote.predict(STATE, ACTIONS * number).instance, range(9)))
    assert sorted(found.count(instance) for instance in "abc") == [3, 3, 3]


def test_a_request_that_is_reached_after_its_budget_is_not_computed(
    session: Session, directory: Directory, start: Start
):
    start("stuck", "tilted", "a")
    directory.wait_for("model", "tilted", timeout_s=START_S)
    address = Address("plating", "model", "tilted", "a")
    with pytest.raises(TimedOutError, match=r"expected a reply within 0\.2 s"):
        ask(
            session,
            address.key("predict"),
            PredictRequest.of(STATE, ACTIONS, content=True),
            PredictReply,
            timeout_s=0.2,
        )
    assert ask(session, address.key("health"), None, Health, timeout_s=5).in_progress == 1


def test_an_expired_budget_is_answered_so(session: Session, directory: Directory, start: Start):
    start("good", "tilted", "a")
    directory.wait_for("model", "tilted", timeout_s=START_S)
    address = Address("plating", "model", "tilted", "a")
    payload, encoding = encode(PredictRequest.of(STATE, ACTIONS, content=True))
    replies = list(session.get(address.key("predict"), payload=payload, encoding=encoding, attachment="-0.5"))
    assert b"expired" in replies[0].err.payload.to_bytes()
    assert ExpiredError.code == "expired"
    assert ask(session, address.key("health"), None, Health, timeout_s=5).served == 0


def test_card_health_and_metrics_are_answered_while_computing(session: Session, directory: Directory, start: Start):
    start("stuck", "tilted", "a")
    directory.wait_for("model", "tilted", timeout_s=START_S)
    address = Address("plating", "model", "tilted", "a")
    payload, encoding = encode(PredictRequest.of(STATE, ACTIONS, content=True))
    session.get(address.key("predict"), lambda _: None, payload=payload, encoding=encoding)
    while ask(session, address.key("health"), None, Health, timeout_s=5).in_progress == 0:
        time.sleep(0.01)
    status = list_workers(session, task="plating")[0]
    assert status.card is not None
    assert status.health is not None
    assert status.health.computing_s is not None
    metrics = next(iter(session.get(address.key("metrics")))).ok.payload.to_string()
    assert 'frugal_in_progress{task="plating",role="model",model="tilted",instance="a"} 1' in metrics


def test_a_waiting_request_is_cancelled_at_once(session: Session, directory: Directory, start: Start):
    start("stuck", "tilted", "a")
    directory.wait_for("model", "tilted", timeout_s=START_S)
    address = Address("plating", "model", "tilted", "a")
    payload, encoding = encode(PredictRequest.of(STATE, ACTIONS, content=True))
    session.get(address.key("predict"), lambda _: None, payload=payload, encoding=encoding)
    waiting = PredictRequest.of(STATE, ACTIONS, content=True)
    with ThreadPoolExecutor(1) as pool:
        future = pool.submit(ask, session, address.key("predict"), waiting, PredictReply, timeout_s=20)
        while ask(session, address.key("health"), None, Health, timeout_s=5).queue_length == 0:
            time.sleep(0.01)
        assert ask(session, address.key(f"cancel/{waiting.id}"), None, CancelReply, timeout_s=5).found
        with pytest.raises(CancelledError, match="taken back before it was computed"):
            future.result(timeout=5)
    assert not ask(session, address.key("cancel/nobody"), None, CancelReply, timeout_s=5).found


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
            future.result(timeout=5)


def test_a_plain_client_asks_in_json_and_is_answered_in_json(session: Session, directory: Directory, start: Start):
    start("good", "tilted", "a")
    directory.wait_for("model", "tilted", timeout_s=START_S)
    payload = encode(PredictRequest.of(STATE, ACTIONS, content=True), form="json")[0]
    reply = next(iter(session.get("frugal/@v1/plating/model/tilted/a/predict", payload=payload)))
    assert reply.ok.encoding == zenoh.Encoding.APPLICATION_JSON
    found = PredictReply.model_validate(json.loads(reply.ok.payload.to_string()))
    np.testing.assert_array_equal(found.heights.values(), Tilted().predict(STATE, ACTIONS).heights)
    card = next(iter(session.get("frugal/@v1/plating/model/tilted/*/card"))).ok.payload.to_string()
    assert json.loads(card)["instance"] == "a"
