"""Weights that are promoted while workers answer: nothing is lost, and every answer says whose it is."""

import json
import os
import re
import shutil
import subprocess
import sys
import threading
import time
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from contextlib import AbstractContextManager, closing
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import safetensors.torch
import zenoh
from conftest import START_S
from torch import Tensor

from common.domain.deviation import Estimates
from common.domain.errors import FrugalError, ModelError
from common.learning.weights import CARD, TENSORS, GridCard, read_card, save
from common.storage.dataset import Dataset
from common.storage.promotion import Promotion
from common.storage.registry import Registry
from common.wire.codec import decode, encode
from common.wire.directory import Directory
from common.wire.dispatch import Limits
from common.wire.messages import EstimateReply, EstimateRequest, LoadReply, LoadRequest
from common.wire.query import ask
from common.wire.remote import RemoteEstimator
from common.wire.session import Session, open_router, open_session
from common.wire.settings import WireSettings
from services.mde.estimator import read_estimator
from tests.fakes import free_endpoint, serving
from tests.mde_fakes import small_settings, write_dataset, write_weights

QUERIES = 1000
ACTIONS = np.array([[0.01, -0.015], [-0.05, 0.02], [0.03, 0.03]])
ROOT = Path(__file__).parents[2]


@pytest.fixture(scope="module")
def dataset(tmp_path_factory: pytest.TempPathFactory) -> Dataset:
    return write_dataset(tmp_path_factory.mktemp("data") / "small")


@pytest.fixture(scope="module")
def made(dataset: Dataset, tmp_path_factory: pytest.TempPathFactory) -> dict[str, Path]:
    """Return folders of weights by version."""
    folder = tmp_path_factory.mktemp("weights")
    for seed, version in enumerate(("1", "2")):
        write_weights(folder / version, dataset, small_settings(seed=seed))
        change_card(folder / version, version=version)
    return {version: folder / version for version in ("1", "2")}


def change_card(folder: Path, **fields: object) -> None:
    path = folder / CARD
    path.write_text(json.dumps(json.loads(path.read_text()) | fields))


@pytest.fixture
def models(made: dict[str, Path], tmp_path: Path) -> Path:
    shutil.copytree(made["1"], tmp_path / "models" / "mde_heuristic")
    return tmp_path / "models"


class Served:
    """An MDE worker on a folder of models, and the command line beside it."""

    def __init__(self, endpoint: str, models: Path, log: Path) -> None:
        self.environment = {**os.environ, "FRUGAL_CONNECT": endpoint, "FRUGAL_MODELS": str(models)}
        self.endpoint, self.log = endpoint, log

    def command(self, *arguments: str) -> subprocess.CompletedProcess[str]:
        command = [sys.executable, "-m", "services.cli.main", "models", *arguments]
        return subprocess.run(command, env=self.environment, capture_output=True, text=True, timeout=60, cwd=ROOT)

    def start(self) -> AbstractContextManager[subprocess.Popen[bytes]]:
        return serving("mde", "--model", "heuristic", "--instance", "m", endpoint=self.endpoint, log=self.log)


@pytest.fixture
def served(endpoint: str, models: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Served:
    monkeypatch.setenv("FRUGAL_MODELS", str(models))
    return Served(endpoint, models, tmp_path / "log")


def test_a_thousand_queries_over_a_promotion_are_all_answered_by_the_version_that_they_name(
    served: Served, directory: Directory, dataset: Dataset, made: dict[str, Path]
):
    state = dataset.state("test", 0)
    local = {version: read_estimator(folder, model="heuristic", threads=1) for version, folder in made.items()}
    actions = np.random.default_rng(0).uniform(-0.05, 0.05, (QUERIES, 2))
    with served.start():
        directory.wait_for("mde", "heuristic", timeout_s=2 * START_S)
        remote = RemoteEstimator(directory, "heuristic", limits=Limits())
        remote.estimate(state, actions[:1])
        promoted, asked = threading.Event(), threading.Event()

        def query(index: int) -> Estimates:
            if index == QUERIES // 4:
                asked.set()
            if index >= QUERIES // 2:
                assert promoted.wait(60)
            return remote.estimate(state, actions[index][None])

        with ThreadPoolExecutor(QUERIES) as pool:
            answers = pool.map(query, range(QUERIES))
            assert asked.wait(60)
            done = served.command("promote", "mde_heuristic", str(made["2"]))
            promoted.set()
            found = list(answers)
        assert done.returncode == 0, done.stderr
        assert "mde/heuristic/m: 2, before 1" in done.stderr
    versions = [answer.version for answer in found]
    assert set(versions) == {"1", "2"}
    assert versions.count("1") >= 1
    assert set(versions[QUERIES // 2 :]) == {"2"}
    for index, answer in enumerate(found):
        expected = local[answer.version].estimate(state, actions[index][None])
        np.testing.assert_array_equal(answer.mean, expected.mean)
        np.testing.assert_array_equal(answer.upper, expected.upper)
        np.testing.assert_array_equal(answer.familiar, expected.familiar)


def test_a_thousand_queries_wait_at_one_worker_at_the_same_time_while_it_takes_weights_over(
    served: Served, session: Session, directory: Directory, dataset: Dataset, made: dict[str, Path]
):
    state, lock = dataset.state("test", 1), threading.Lock()
    replies: list[tuple[str, str | None]] = []
    all_there = threading.Semaphore(0)
    with served.start():
        (worker,) = directory.wait_for("mde", "heuristic", timeout_s=2 * START_S)
        key = worker.address.key("estimate")
        first = EstimateRequest.of(state, np.zeros((1, 2)), content=True)
        ask(session, key, first, EstimateReply, timeout_s=20)

        load = LoadRequest(card=(made["2"] / CARD).read_bytes(), tensors=(made["2"] / TENSORS).read_bytes())
        load_key = worker.address.key("load")
        taken = threading.Thread(target=lambda: ask(session, load_key, load, LoadReply, timeout_s=60))

        def keep(reply: zenoh.Reply) -> None:
            assert reply.ok is not None, reply.err.payload.to_string()
            with lock:
                told = decode(reply.ok.payload.to_bytes(), str(reply.ok.encoding), EstimateReply)
                replies.append((told.version, told.weights))

        handler = [zenoh.handlers.Callback(keep, all_there.release, indirect=True) for _ in range(QUERIES)]
        for index in range(QUERIES):
            request = EstimateRequest.of(state, np.full((1, 2), 1e-5 * index), content=False)
            payload, encoding = encode(request)
            session.get(key, handler[index], payload=payload, encoding=encoding, attachment="60", timeout=60.0)
            if index == QUERIES // 2:
                taken.start()
        for _ in range(QUERIES):
            assert all_there.acquire(timeout=60)
        taken.join()
    assert len(replies) == QUERIES
    assert set(replies) == {(version, read_card(made[version]).sha256) for version in ("1", "2")}


def test_a_worker_that_starts_after_a_promotion_begins_with_the_promoted_version_and_a_rollback_brings_it_back(
    served: Served, directory: Directory, dataset: Dataset, made: dict[str, Path]
):
    state = dataset.state("test", 0)
    alone = served.command("promote", "mde_heuristic", str(made["2"]))
    assert alone.returncode == 0
    assert "no live worker of the MDE of heuristic" in alone.stderr
    with served.start():
        directory.wait_for("mde", "heuristic", timeout_s=2 * START_S)
        remote = RemoteEstimator(directory, "heuristic", limits=Limits())
        assert remote.estimate(state, np.zeros((1, 2))).version == "2"
        listed = json.loads(served.command("list", "--json").stdout)
        assert [(one["version"], one["active"], one["workers"]) for one in listed] == [
            ("1", False, []),
            ("2", True, ["mde/heuristic/m"]),
        ]
        back = served.command("rollback", "mde_heuristic")
        assert back.returncode == 0, back.stderr
        assert remote.estimate(state, np.zeros((1, 2))).version == "1"


def test_a_worker_that_waits_for_a_router_begins_with_what_is_promoted_meanwhile(
    models: Path, made: dict[str, Path], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
):
    monkeypatch.setenv("FRUGAL_MODELS", str(models))
    settings = WireSettings(connect=(endpoint := free_endpoint(),), listen=(endpoint,))
    alone = Served(endpoint, models, tmp_path / "log")
    with alone.start():
        while "waiting for a Zenoh router" not in (tmp_path / "log").read_text():
            time.sleep(0.05)
        registry = Registry(models)
        registry.add("mde_heuristic", made["2"])
        Promotion(registry, "mde_heuristic", None, print).promote("2")
        with (
            open_router(settings),
            open_session(settings, wait_s=START_S) as session,
            closing(Directory(session, task="plating")) as directory,
        ):
            (worker,) = directory.wait_for("mde", "heuristic", timeout_s=2 * START_S)
            assert worker.card is not None
            assert worker.card.version == "2"


def test_a_worker_that_is_killed_after_a_promotion_comes_back_with_the_promoted_version(
    served: Served, directory: Directory, dataset: Dataset, made: dict[str, Path]
):
    state = dataset.state("test", 0)
    with served.start() as process:
        directory.wait_for("mde", "heuristic", timeout_s=2 * START_S)
        done = served.command("promote", "mde_heuristic", str(made["2"]), "--wait")
        assert done.returncode == 0, done.stderr
        process.kill()
        while gone := directory.workers("mde", "heuristic"):
            directory.wait_for_change(0.1)
            directory.probe(gone[0].address)
    with served.start():
        directory.wait_for("mde", "heuristic", timeout_s=2 * START_S)
        answer = RemoteEstimator(directory, "heuristic", limits=Limits()).estimate(state, ACTIONS)
    expected = read_estimator(made["2"], model="heuristic", threads=1).estimate(state, ACTIONS)
    assert answer.version == "2"
    np.testing.assert_array_equal(answer.mean, expected.mean)


def save_again(
    folder: Path, *, change: Callable[[dict[str, Tensor]], object] = lambda tensors: None, **fields: Any
) -> None:
    """Write other tensors and what else is changed on the card, so that the SHA-256 is right."""
    tensors = safetensors.torch.load((folder / TENSORS).read_bytes())
    change(tensors)
    save(folder, tensors, read_card(folder).model_copy(update=fields))


def put(name: str, place: int, value: float) -> Callable[[dict[str, Tensor]], object]:
    return lambda tensors: tensors[name].view(-1)[place].fill_(value)


UNFIT: dict[str, tuple[Callable[[Path], object], str]] = {
    "NaN": (lambda folder: save_again(folder, change=put("means", 0, np.nan)), "means: expected finite numbers"),
    "another grid": (
        lambda folder: save_again(
            folder, change=put("facts", 2, 0.004501), grid=GridCard(rows=64, columns=64, cell=0.004501)
        ),
        "mde_heuristic: grid: expected .*0.0045.* as of the MDE that is served, got .*0.004501",
    ),
    "another scale": (
        lambda folder: save_again(folder, change=put("facts", 3, 0.01), deviation_scale_m=0.01),
        "deviation_scale_m: expected .* as of the MDE that is served, got 0.01",
    ),
}


def test_weights_that_are_what_their_card_says_but_do_not_fit_are_refused_and_leave_nothing_behind(
    served: Served, directory: Directory, dataset: Dataset, made: dict[str, Path], models: Path, tmp_path: Path
):
    state = dataset.state("test", 0)
    expected = read_estimator(made["1"], model="heuristic", threads=1).estimate(state, ACTIONS)
    with served.start():
        directory.wait_for("mde", "heuristic", timeout_s=2 * START_S)
        remote = RemoteEstimator(directory, "heuristic", limits=Limits())
        for name, (spoil, message) in UNFIT.items():
            folder = shutil.copytree(made["2"], tmp_path / name)
            spoil(folder)
            done = served.command("promote", "mde_heuristic", str(folder))
            assert done.returncode == 1
            assert re.search(message, done.stderr.splitlines()[-1]), done.stderr
            answer = remote.estimate(state, ACTIONS)
            assert answer.version == "1"
            np.testing.assert_array_equal(answer.mean, expected.mean)
        assert [one.version for one in Registry(models).versions("mde_heuristic")] == ["1"]


def spoil_tensors(folder: Path) -> None:
    content = bytearray((folder / TENSORS).read_bytes())
    content[-1] ^= 1
    (folder / TENSORS).write_bytes(content)


def test_weights_that_lie_are_refused_and_the_old_ones_go_on(
    served: Served, session: Session, directory: Directory, dataset: Dataset, made: dict[str, Path], tmp_path: Path
):
    state = dataset.state("test", 0)
    lies = {
        "flipped": (spoil_tensors, "expected SHA-256"),
        "grid": (lambda folder: change_card(folder, grid={"rows": 96, "columns": 96, "cell": 0.003}), "grid"),
        "scale": (lambda folder: change_card(folder, deviation_scale_m=0.5), "deviation_scale_m"),
        "model": (lambda folder: change_card(folder, name="mde_learned"), "expected weights of mde_heuristic"),
    }
    with served.start():
        (worker,) = directory.wait_for("mde", "heuristic", timeout_s=2 * START_S)
        remote = RemoteEstimator(directory, "heuristic", limits=Limits())
        for name, (spoil, message) in lies.items():
            folder = shutil.copytree(made["2"], tmp_path / name)
            spoil(folder)
            request = LoadRequest(card=(folder / CARD).read_bytes(), tensors=(folder / TENSORS).read_bytes())
            with pytest.raises(ModelError, match=message):
                ask(session, worker.address.key("load"), request, LoadReply, timeout_s=20)
            assert remote.estimate(state, np.zeros((1, 2))).version == "1"
        folder = shutil.copytree(made["2"], tmp_path / "scale-again")
        change_card(folder, deviation_scale_m=0.5, version="3")
        refused = served.command("promote", "mde_heuristic", str(folder))
        assert refused.returncode == 1
        assert "deviation_scale_m: expected" in refused.stderr
        listed = json.loads(served.command("list", "--json").stdout)
        assert [one["version"] for one in listed if one["active"]] == ["1"]
        with pytest.raises(FrugalError):
            ask(session, worker.address.key("load"), LoadRequest(card=b"", tensors=b""), LoadReply, timeout_s=20)
