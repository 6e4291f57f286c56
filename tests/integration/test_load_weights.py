"""Promotions to fake MDE workers: whom they reach, what they do not hold up, and what a refusal leaves behind."""

import hashlib
import json
import threading
import time
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import numpy as np
import pytest
import zenoh

from common.domain.deviation import Estimates
from common.domain.errors import FrugalError, ModelError, UnavailableError
from common.storage.promotion import LOAD_S, Promotion, is_gone
from common.storage.registry import CARD, TENSORS, Registry
from common.wire.directory import Directory
from common.wire.dispatch import Limits
from common.wire.keys import Address
from common.wire.messages import LoadReply, LoadRequest
from common.wire.query import ask
from common.wire.remote import RemoteEstimator
from common.wire.session import Session
from tests.conftest import START_S, Start
from tests.fakes import make_state

ACTION = np.array([[0.01, 0.02]])
Promote = Callable[[str, str], list[str]]


def write(folder: Path, version: str, *, name: str = "mde_tilted", content: str = "") -> Path:
    tensors = (content or f"{folder.name} {version}").encode()
    folder.mkdir(parents=True)
    (folder / TENSORS).write_bytes(tensors)
    card = {"name": name, "version": version, "sha256": hashlib.sha256(tensors).hexdigest()}
    (folder / CARD).write_text(json.dumps(card))
    return folder


@pytest.fixture
def registry(tmp_path: Path) -> Registry:
    """Return versions 1, released and active, and 2 of the MDE of ``tilted``."""
    write(tmp_path / "models" / "mde_tilted", "1")
    found = Registry(tmp_path / "models")
    found.add("mde_tilted", write(tmp_path / "new", "2"))
    return found


@pytest.fixture
def promote(registry: Registry, session: Session) -> Promote:
    """Return what promotes a version of a name, and returns what was said meanwhile, also by an error."""

    def promote_one(name: str, version: str) -> list[str]:
        said: list[str] = []
        try:
            Promotion(registry, name, session, said.append).promote(version)
        except FrugalError as error:
            said.append(f"{error.code}: {error}")
        return said

    return promote_one


def load(session: Session, directory: Directory, folder: Path, *, instance: str = "a") -> LoadReply:
    (worker,) = [one for one in directory.workers("mde", "tilted") if one.address.instance == instance]
    request = LoadRequest(card=(folder / CARD).read_bytes(), tensors=(folder / TENSORS).read_bytes())
    return ask(session, worker.address.key("load"), request, LoadReply, timeout_s=10)


def served(directory: Directory, *, count: int) -> dict[str, str]:
    """Return the version on the card of every worker, as it is now."""
    fresh = Directory(directory.session, task="plating")
    try:
        found = fresh.wait_for("mde", "tilted", count=count, timeout_s=START_S)
    finally:
        fresh.close()
    return {one.address.instance: one.card.version for one in found if one.card is not None}


def active(registry: Registry, name: str = "mde_tilted") -> list[str]:
    return [one.version for one in registry.versions(name) if one.is_active]


def test_every_worker_takes_a_promoted_version_over_and_one_that_has_it_is_left_alone(
    start: Start, session: Session, directory: Directory, registry: Registry, promote: Promote, tmp_path: Path
):
    for instance in ("a", "b"):
        start("mde-loading", "tilted", instance)
    directory.wait_for("mde", "tilted", count=2, timeout_s=START_S)
    load(session, directory, tmp_path / "new", instance="b")
    assert promote("mde_tilted", "2") == ["mde/tilted/a: 2, before 1", "mde/tilted/b: 2 already"]
    assert served(directory, count=2) == {"a": "2", "b": "2"}
    assert active(registry) == ["2"]


def test_a_worker_that_refuses_brings_all_back_to_the_version_before(
    start: Start, directory: Directory, registry: Registry, promote: Promote
):
    for instance in ("a", "picky"):
        start("mde-loading", "tilted", instance)
    directory.wait_for("mde", "tilted", count=2, timeout_s=START_S)
    assert promote("mde_tilted", "2") == [
        "mde/tilted/a: 2, before 1",
        "mde/tilted/a: 1, before 2",
        "model: mde/tilted/picky: expected other weights than version 2",
    ]
    assert served(directory, count=2) == {"a": "1", "picky": "1"}
    assert active(registry) == ["1"]


def test_a_worker_that_cannot_take_weights_over_brings_all_back_too(
    start: Start, directory: Directory, registry: Registry, promote: Promote
):
    start("mde", "tilted", "fixed")
    directory.wait_for("mde", "tilted", timeout_s=START_S)
    (said,) = promote("mde_tilted", "2")
    assert said.startswith("unavailable: mde/tilted/fixed: expected it to take weights over, got no reply")
    assert active(registry) == ["1"]


def test_a_worker_that_dies_meanwhile_holds_nobody_up(
    start: Start, directory: Directory, registry: Registry, promote: Promote
):
    start("mde-loading", "tilted", "mortal")
    start("mde-loading", "tilted", "z")
    directory.wait_for("mde", "tilted", count=2, timeout_s=START_S)
    assert promote("mde_tilted", "2") == ["mde/tilted/mortal: gone", "mde/tilted/z: 2, before 1"]
    assert active(registry) == ["2"]


def test_a_question_that_a_dying_worker_took_with_it_holds_nobody_up(session: Session):
    gone, kept = Address("plating", "mde", "tilted", "gone"), list[zenoh.Query]()
    first = threading.Event()

    def take_along(query: zenoh.Query) -> None:
        kept.append(query)
        first.set()

    began = time.monotonic()
    with ThreadPoolExecutor(1) as pool:
        with session.declare_queryable(gone.key("health"), take_along):
            asked = pool.submit(is_gone, session, gone)
            assert first.wait(START_S)
        assert asked.result()
    assert len(kept) == 1
    assert time.monotonic() - began < LOAD_S / 2


def test_the_first_version_of_an_mde_that_was_never_released_is_promoted(
    start: Start, directory: Directory, registry: Registry, promote: Promote, tmp_path: Path
):
    start("mde-loading", "flat", "a")
    directory.wait_for("mde", "flat", timeout_s=START_S)
    registry.add("mde_flat", write(tmp_path / "flat", "1-s2r", name="mde_flat"))
    assert promote("mde_flat", "1-s2r") == ["mde/flat/a: 1-s2r, before 1"]
    assert active(registry, "mde_flat") == ["1-s2r"]


def test_the_first_version_of_an_mde_that_was_never_released_can_be_refused(
    start: Start, directory: Directory, registry: Registry, promote: Promote, tmp_path: Path
):
    start("mde-loading", "flat", "picky")
    directory.wait_for("mde", "flat", timeout_s=START_S)
    registry.add("mde_flat", write(tmp_path / "flat", "1-s2r", name="mde_flat"))
    assert promote("mde_flat", "1-s2r") == ["model: mde/flat/picky: expected other weights than version 1-s2r"]
    assert active(registry, "mde_flat") == []


def test_a_family_of_weights_is_promoted_to_the_workers_that_serve_it_alone(
    start: Start, session: Session, directory: Directory, registry: Registry, promote: Promote, tmp_path: Path
):
    narrow = write(tmp_path / "models" / "narrow" / "mde_tilted", "1", content="narrow")
    registry.add("narrow/mde_tilted", write(tmp_path / "narrower", "2-narrow"))
    for instance in ("narrow", "wide"):
        start("mde-loading", "tilted", instance)
    directory.wait_for("mde", "tilted", count=2, timeout_s=START_S)
    load(session, directory, narrow, instance="narrow")
    assert promote("mde_tilted", "2") == ["mde/tilted/wide: 2, before 1"]
    assert promote("narrow/mde_tilted", "2-narrow") == ["mde/tilted/narrow: 2-narrow, before 1"]
    assert served(directory, count=2) == {"narrow": "2-narrow", "wide": "2"}


def test_a_load_waits_for_no_query_and_what_is_computed_ends_with_the_weights_before(
    start: Start, session: Session, directory: Directory, tmp_path: Path
):
    start("mde-loading-slow", "tilted", "a", 1)
    (worker,) = directory.wait_for("mde", "tilted", timeout_s=START_S)
    remote, answers = RemoteEstimator(directory, "tilted", limits=Limits()), list[Estimates]()
    asking = [threading.Thread(target=lambda: answers.append(remote.estimate(make_state(), ACTION))) for _ in range(2)]
    for thread in asking:  # one is computed, one fills the queue
        thread.start()
        time.sleep(0.3)
    began = time.monotonic()
    reply = load(session, directory, write(tmp_path / "new", "2"))
    assert time.monotonic() - began < 1.0
    assert (reply.previous, reply.version) == ("1", "2")
    for thread in asking:
        thread.join()
    assert [answer.version for answer in answers] == ["1", "2"]
    assert worker.address.instance == answers[0].instance


def test_weights_for_another_model_change_nothing(start: Start, session: Session, directory: Directory, tmp_path: Path):
    start("mde-loading", "tilted", "a")
    directory.wait_for("mde", "tilted", timeout_s=START_S)
    with pytest.raises(ModelError, match="model: expected tilted as of the MDE that is served, got flat"):
        load(session, directory, write(tmp_path / "flat", "2", name="mde_flat"))
    assert served(directory, count=1) == {"a": "1"}
    assert RemoteEstimator(directory, "tilted", limits=Limits()).estimate(make_state(), ACTION).version == "1"


def test_who_has_seen_a_card_sees_the_new_one_after_an_answer(
    start: Start, session: Session, directory: Directory, tmp_path: Path
):
    start("mde-loading", "tilted", "a")
    directory.wait_for("mde", "tilted", timeout_s=START_S)
    remote = RemoteEstimator(directory, "tilted", limits=Limits())
    load(session, directory, write(tmp_path / "new", "2"))
    deadline = time.monotonic() + START_S
    while [one.card and one.card.version for one in directory.workers("mde", "tilted")] != ["2"]:
        assert remote.estimate(make_state(), ACTION).version == "2"
        assert time.monotonic() < deadline
        directory.wait_for_change(0.05)


def test_without_a_worker_nobody_is_waited_for_longer_than_told(registry: Registry, session: Session):
    with pytest.raises(UnavailableError, match=r"expected a live MDE of tilted within 0.2 s, got none"):
        Promotion(registry, "mde_tilted", session, lambda line: None).wait_for_worker(timeout_s=0.2)
