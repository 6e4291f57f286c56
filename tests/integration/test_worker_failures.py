"""Workers that die, stop, hang, raise or lie, in the middle of a call."""

import os
import signal
import time
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import numpy as np
import pytest
from conftest import START_S, Start

from common.domain.errors import ModelError, RequestError, TimedOutError, UnavailableError
from common.wire.directory import Directory
from common.wire.dispatch import PATIENCE_S, Limits
from common.wire.keys import Address
from common.wire.messages import Health
from common.wire.query import ask
from common.wire.remote import RemoteEstimator, RemoteModel
from common.wire.session import open_router, open_session
from common.wire.settings import WireSettings
from tests.fakes import Tilted, free_endpoint, make_state, running

STATE = make_state()
ACTIONS = np.array([[0.01, 0.02]])
EXPECTED = Tilted().predict(STATE, ACTIONS).heights
LIMITS = Limits(timeout_s=30.0)


def wait_until_computing(directory: Directory, instance: str) -> None:
    address = next(worker.address for worker in directory.workers("model") if worker.address.instance == instance)
    while ask(directory.session, address.key("health"), None, Health, timeout_s=5).in_progress == 0:
        time.sleep(0.01)


def predict_with_a_bad_replica(
    directory: Directory, start: Start, kind: str, harm: signal.Signals | None, limits: Limits = LIMITS
) -> tuple[str, list[str]]:
    """Call a bad replica ``a`` while ``b`` is good, and return who answered and the kinds of the events."""
    bad = start(kind, "tilted", "a")
    directory.wait_for("model", "tilted", timeout_s=START_S)
    remote = RemoteModel(directory, "tilted", limits=limits)
    with ThreadPoolExecutor(1) as pool:
        future = pool.submit(remote.predict, STATE, ACTIONS) if harm else None
        if harm:
            wait_until_computing(directory, "a")
        start("good", "tilted", "b")
        directory.wait_for("model", "tilted", count=2, timeout_s=START_S)
        if harm:
            os.kill(bad.pid, harm)
        found = future.result(timeout=60) if future else remote.predict(STATE, ACTIONS)
    np.testing.assert_array_equal(found.heights, EXPECTED)
    assert all(event.worker == "tilted/a" for event in found.events)
    return found.instance, [event.kind for event in found.events]


def test_a_worker_killed_in_mid_call_is_replaced_by_another(directory: Directory, start: Start):
    assert predict_with_a_bad_replica(directory, start, "stuck", signal.SIGKILL) == ("b", ["no_reply"])


def test_a_worker_stopped_in_mid_call_is_replaced_by_another(directory: Directory, start: Start):
    assert predict_with_a_bad_replica(directory, start, "stuck", signal.SIGSTOP) == ("b", ["no_reply"])


def test_a_worker_told_to_end_in_mid_call_is_replaced_by_another(directory: Directory, start: Start):
    assert predict_with_a_bad_replica(directory, start, "stuck", signal.SIGTERM) == ("b", ["unavailable"])


@pytest.mark.parametrize("kind", ["raising", "lying", "infinite"])
def test_a_broken_replica_does_not_fail_a_call(directory: Directory, start: Start, kind: str):
    assert predict_with_a_bad_replica(directory, start, kind, None) == ("b", ["model_error"])
    suspects = {worker.address.instance for worker in directory.workers("model") if worker.is_suspect}
    assert suspects == {"a"}
    assert RemoteModel(directory, "tilted", limits=LIMITS).predict(STATE, ACTIONS).events == ()


def test_a_token_with_nobody_behind_it_is_forgotten(directory: Directory, start: Start):
    ghost = Address("plating", "model", "tilted", "a")
    with directory.session.liveliness().declare_token(ghost.key("live")):
        start("good", "tilted", "b")
        directory.wait_for("model", "tilted", timeout_s=START_S)
        found = RemoteModel(directory, "tilted", limits=LIMITS).predict(STATE, ACTIONS)
        assert (found.instance, [event.kind for event in found.events]) == ("b", ["no_reply"])
        assert [worker.address.instance for worker in directory.workers("model")] == ["b"]


def test_a_hanging_worker_is_left_after_the_timeout(directory: Directory, start: Start):
    limits = Limits(timeout_s=2.0)
    assert predict_with_a_bad_replica(directory, start, "stuck", None, limits) == ("b", ["timed_out"])


@pytest.mark.parametrize(
    ("kind", "said"),
    [
        ("raising", "tilted/a: ZeroDivisionError: the solver diverged"),
        ("lying", r"expected heightmaps \(1, 8, 10\) and 1 warnings, got float32 \(1, 2, 3\) and 1"),
        ("infinite", "expected finite heights, got NaN or infinite ones"),
    ],
)
def test_an_error_of_the_only_worker_is_the_model_s_and_has_no_traceback(
    directory: Directory, start: Start, kind: str, said: str
):
    start(kind, "tilted", "a")
    directory.wait_for("model", "tilted", timeout_s=START_S)
    with pytest.raises(ModelError, match=said) as caught:
        RemoteModel(directory, "tilted", limits=LIMITS).predict(STATE, ACTIONS)
    assert "Traceback" not in str(caught.value)


def test_an_estimator_s_own_error_keeps_its_text(directory: Directory, start: Start):
    start("mde-raising", "tilted", "a")
    directory.wait_for("mde", "tilted", timeout_s=START_S)
    with pytest.raises(ModelError, match="no weights"):
        RemoteEstimator(directory, "tilted", limits=LIMITS).estimate(STATE, ACTIONS)


def test_a_timeout_of_the_only_worker_is_raised(directory: Directory, start: Start):
    start("stuck", "tilted", "a")
    directory.wait_for("model", "tilted", timeout_s=START_S)
    with pytest.raises(TimedOutError, match=r"expected a reply within 0\.3 s"):
        RemoteModel(directory, "tilted", limits=Limits(timeout_s=0.3)).predict(STATE, ACTIONS)


def test_a_wrong_request_is_not_tried_elsewhere(directory: Directory, start: Start):
    for instance in ("a", "b"):
        start("good", "tilted", instance)
    directory.wait_for("model", "tilted", count=2, timeout_s=START_S)
    remote = RemoteModel(directory, "tilted", limits=LIMITS)
    remote.largest_batch = 100
    with pytest.raises(RequestError, match="with B from 1 to 32"):
        remote.predict(STATE, np.zeros((33, 2)))
    healths = [
        ask(directory.session, worker.address.key("health"), None, Health, timeout_s=5)
        for worker in directory.workers()
    ]
    assert sum(health.refused for health in healths) == 1


def test_without_a_worker_the_error_names_what_is_missing_within_2_s(directory: Directory, start: Start):
    worker = start("good", "tilted", "a")
    directory.wait_for("model", "tilted", timeout_s=START_S)
    remote = RemoteModel(directory, "tilted", limits=LIMITS)
    worker.kill()
    worker.wait()
    with pytest.raises(UnavailableError, match="expected a live worker for model tilted of plating, got none"):
        remote.predict(STATE, ACTIONS)
    assert PATIENCE_S < 2.0
    with pytest.raises(UnavailableError, match="expected 1 live model tilted of plating, got 0"):
        RemoteModel(directory, "tilted", limits=LIMITS)


def test_a_worker_that_joins_meanwhile_answers(directory: Directory, start: Start):
    changes: list[tuple[str, str]] = []
    directory.on_change(lambda event: changes.append((event.kind, event.worker)))
    first = start("good", "tilted", "a")
    directory.wait_for("model", "tilted", timeout_s=START_S)
    start("good", "tilted", "b")
    directory.wait_for("model", "tilted", count=2, timeout_s=START_S)
    first.kill()
    remote = RemoteModel(directory, "tilted", limits=LIMITS)
    assert {remote.predict(STATE, ACTIONS).instance for _ in range(4)} >= {"b"}
    while ("left", "tilted/a") not in changes:
        directory.wait_for_change(0.1)
    assert changes[:2] == [("joined", "tilted/a"), ("joined", "tilted/b")]


@pytest.mark.parametrize("number", [signal.SIGTERM, signal.SIGINT])
def test_a_worker_leaves_cleanly_when_told_to(directory: Directory, start: Start, number: signal.Signals):
    worker = start("good", "tilted", "a")
    directory.wait_for("model", "tilted", timeout_s=START_S)
    worker.send_signal(number)
    assert worker.wait(timeout=60) == 0
    while directory.workers("model"):
        directory.wait_for_change(0.1)


def test_a_worker_finishes_what_it_computes_before_it_leaves(directory: Directory, start: Start):
    worker = start("slow", "tilted", "a")
    directory.wait_for("model", "tilted", timeout_s=START_S)
    remote = RemoteModel(directory, "tilted", limits=LIMITS)
    with ThreadPoolExecutor(1) as pool:
        future = pool.submit(remote.predict, STATE, ACTIONS)
        wait_until_computing(directory, "a")
        worker.terminate()
        assert future.result(timeout=60).events == ()
    assert worker.wait(timeout=60) == 0


def test_a_worker_that_computes_for_ever_still_ends(directory: Directory, start: Start):
    worker = start("stuck", "tilted", "a")
    directory.wait_for("model", "tilted", timeout_s=START_S)
    remote = RemoteModel(directory, "tilted", limits=LIMITS)
    with ThreadPoolExecutor(1) as pool:
        future = pool.submit(remote.predict, STATE, ACTIONS)
        wait_until_computing(directory, "a")
        worker.terminate()
        with pytest.raises(UnavailableError, match=r"tried tilted/a \(unavailable\)"):
            future.result(timeout=60)
    assert worker.wait(timeout=60) == 0


def test_a_worker_waits_for_the_router_and_can_be_ended_while_it_waits(tmp_path: Path):
    log = tmp_path / "log"
    with running("good", "tilted", "a", endpoint=free_endpoint(), log=log) as worker:
        while b"waiting for a Zenoh router" not in (log.read_bytes() if log.exists() else b""):
            time.sleep(0.05)
        worker.terminate()
        assert worker.wait(timeout=60) == 0


def test_without_a_router_a_client_says_so():
    settings = WireSettings(connect=(free_endpoint(),))
    with pytest.raises(UnavailableError, match=r"expected a Zenoh router at tcp/127\.0\.0\.1"):
        open_session(settings, wait_s=1.0)


def test_an_endpoint_in_use_is_said_in_one_line(endpoint: str, tmp_path: Path):
    log = tmp_path / "log"
    with running("router", endpoint=endpoint, log=log) as second:
        assert second.wait(timeout=60) != 0
    assert b"expected to listen on" in log.read_bytes()


def test_a_router_restart_is_survived_by_sessions_workers_and_calls(tmp_path: Path):
    endpoint = free_endpoint()
    settings = WireSettings(connect=(endpoint,), listen=(endpoint,))
    router = open_router(settings)
    with (
        running("stuck", "tilted", "a", endpoint=endpoint, log=tmp_path / "log") as stuck,
        running("good", "tilted", "b", endpoint=endpoint, log=tmp_path / "log"),
        open_session(settings, wait_s=START_S) as session,
        ThreadPoolExecutor(1) as pool,
    ):
        directory = Directory(session, task="plating")
        directory.wait_for("model", "tilted", count=2, timeout_s=START_S)
        remote = RemoteModel(directory, "tilted", limits=LIMITS)
        future = pool.submit(remote.predict, STATE, ACTIONS)
        wait_until_computing(directory, "a")
        router.close()
        stuck.kill()
        with open_router(settings):
            found = future.result(timeout=60)
            assert found.instance == "b"
            assert {event.kind for event in found.events} == {"no_reply"}
            assert not directory.is_partitioned()


def test_a_router_ends_when_told_to(tmp_path: Path):
    endpoint = free_endpoint()
    with (
        running("router", endpoint=endpoint, log=tmp_path / "log") as router,
        open_session(WireSettings(connect=(endpoint,)), wait_s=START_S),
    ):
        router.terminate()
        assert router.wait(timeout=60) == 0
