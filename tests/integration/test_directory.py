"""Who is alive and can be asked, also where Zenoh does not tell it."""

import time
from collections.abc import Iterator
from contextlib import contextmanager

import numpy as np
import pytest
import zenoh
from conftest import START_S, Start

from common.domain.errors import UnavailableError
from common.domain.grid import Grid
from common.domain.scene import Item, Scene, State
from common.wire.codec import encode
from common.wire.directory import HEARD_S, LOOK_S, Directory
from common.wire.dispatch import Limits
from common.wire.keys import Address
from common.wire.messages import Card, PredictReply
from common.wire.remote import RemoteModel
from common.wire.session import Session, open_session
from common.wire.settings import WireSettings
from tests.fakes import GRID, Tilted, make_state

STATE = make_state()
ACTIONS = np.array([[0.01, 0.02]])
LIMITS = Limits(timeout_s=30.0)


@pytest.fixture
def deaf(settings: WireSettings) -> Iterator[Directory]:
    """Return a directory that is told of no token, on a session of its own."""
    with open_session(settings, wait_s=START_S) as session:
        found = Directory(session, task="plating")
        found.close()
        yield found


def on_another_grid() -> State:
    grid = Grid(5, 6, 0.02)
    heights, materials = np.zeros(grid.shape, np.float32), np.zeros((3, *grid.shape), np.float32)
    item, item_materials = heights.copy(), materials.copy()
    item[2, 2:4], item_materials[:, 2, 2:4] = 0.01, np.array([[1000.0], [1e5], [0.4]])
    return State(Scene(grid, heights, materials), Item(item, item_materials))


def test_a_worker_whose_token_was_not_told_is_found_by_who_waits_for_it(deaf: Directory, start: Start):
    start("good", "tilted", "a")
    assert [worker.address.instance for worker in deaf.wait_for("model", "tilted", timeout_s=START_S)] == ["a"]


def test_a_worker_whose_token_was_not_told_is_found_in_mid_call(deaf: Directory, directory: Directory, start: Start):
    first = start("good", "tilted", "a")
    deaf.wait_for("model", "tilted", timeout_s=START_S)
    remote = RemoteModel(deaf, "tilted", limits=LIMITS)
    first.kill()
    start("good", "tilted", "b")
    while [worker.address.instance for worker in directory.workers("model", "tilted")] != ["b"]:
        directory.wait_for_change(0.1)
    time.sleep(LOOK_S)
    found = remote.predict(STATE, ACTIONS)
    assert (found.instance, [event.kind for event in found.events]) == ("b", ["no_reply"])


@contextmanager
def showing_a_card(session: Session, address: Address) -> Iterator[Card]:
    """Answer a worker's card key."""
    card = Card(task="plating", role="model", model="tilted", instance=address.instance, version="7")

    def show(query: zenoh.Query) -> None:
        payload, encoding = encode(card)
        with query:
            query.reply(address.key("card"), payload, encoding=encoding)

    with session.declare_queryable(address.key("card"), show, complete=True):
        yield card


def test_a_forgotten_worker_that_shows_its_card_again_comes_back_as_a_suspect(session: Session, directory: Directory):
    back = Address("plating", "model", "tilted", "back")
    with session.liveliness().declare_token(back.key("live")):
        while not directory.workers("model", "tilted"):
            directory.wait_for_change(0.1)
        assert not directory.probe(back)
        assert directory.workers("model", "tilted") == ()
        with showing_a_card(session, back):
            assert directory.wait_for("model", "tilted", timeout_s=START_S)[0].is_suspect
    while directory.workers("model", "tilted"):
        directory.wait_for_change(0.1)


def test_a_worker_that_answers_other_calls_is_not_given_up_for_a_silent_health_key(
    session: Session, directory: Directory
):
    busy = Address("plating", "model", "tilted", "busy")
    reply = PredictReply.of(Tilted().predict(STATE, ACTIONS), instance="busy", compute_s=0.001)

    def answer_late(query: zenoh.Query) -> None:
        for _ in range(20):
            time.sleep(0.1)
            directory.record(busy, digest=STATE.digest, batch=1, compute_s=0.001, load=1)
        payload, encoding = encode(reply)
        with query:
            query.reply(busy.key("predict"), payload, encoding=encoding)

    handler = zenoh.handlers.Callback(answer_late, indirect=True)
    with (
        session.declare_queryable(busy.key("predict"), handler, complete=True),
        session.liveliness().declare_token(busy.key("live")),
        showing_a_card(session, busy),
    ):
        directory.wait_for("model", "tilted", timeout_s=START_S)
        directory.record(busy, digest=STATE.digest, batch=1, compute_s=0.001, load=1)
        assert RemoteModel(directory, "tilted", limits=LIMITS).predict(STATE, ACTIONS).events == ()
        time.sleep(HEARD_S)
        assert not directory.answers(busy)


def test_a_card_that_did_not_come_is_asked_for_again(session: Session, directory: Directory):
    late = Address("plating", "model", "tilted", "late")
    with session.liveliness().declare_token(late.key("live")):
        while not directory.workers("model", "tilted"):
            directory.wait_for_change(0.1)
        assert directory.workers("model", "tilted")[0].card is None
        with showing_a_card(session, late) as card:
            while directory.workers("model", "tilted")[0].card != card:
                directory.wait_for_change(0.1)
    while directory.workers("model", "tilted"):
        directory.wait_for_change(0.1)


def test_only_replicas_that_take_the_grid_are_asked(directory: Directory, start: Start):
    start("good", "tilted", "picky")
    start("slow", "tilted", "any")
    directory.wait_for("model", "tilted", count=2, timeout_s=START_S)
    remote = RemoteModel(directory, "tilted", limits=LIMITS)
    found = [remote.predict(on_another_grid(), ACTIONS) for _ in range(3)]
    assert {(one.instance, one.events) for one in found} == {("any", ())}
    assert {remote.predict(STATE, ACTIONS).instance for _ in range(3)} >= {"picky"}


def test_the_grid_that_no_replica_takes_is_named(directory: Directory, start: Start):
    start("good", "tilted", "picky")
    directory.wait_for("model", "tilted", timeout_s=START_S)
    remote = RemoteModel(directory, "tilted", limits=LIMITS)
    with pytest.raises(
        UnavailableError, match=r"model tilted that takes Grid\(rows=5, columns=6, cell=0\.02\) of plat"
    ):
        remote.predict(on_another_grid(), ACTIONS)
    assert remote.predict(STATE, ACTIONS).heights.shape == (1, *GRID.shape)
