"""Bad input: a clear error reply, and the same worker serves the next query."""

import subprocess
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import msgpack
import numpy as np
import pytest
from conftest import START_S

from common.wire.array import Array
from common.wire.codec import decode
from common.wire.directory import Directory
from common.wire.keys import Address
from common.wire.messages import ErrorReply, PredictReply, PredictRequest
from common.wire.query import ask
from common.wire.session import Session
from common.wire.state import StateMessage
from tests.fakes import make_state, running

STATE = make_state()
ACTIONS = np.array([[0.01, 0.02]])
PACKED = "application/msgpack;PredictRequest"
KEYS = {
    "model": Address("plating", "model", "tilted", "strict").key("predict"),
    "orchestrator": Address("plating", "orchestrator", None, "strict").key("optimize"),
}


@pytest.fixture(scope="module")
def workers(
    endpoint: str, session: Session, tmp_path_factory: pytest.TempPathFactory
) -> Iterator[tuple[subprocess.Popen[bytes], ...]]:
    log: Path = tmp_path_factory.mktemp("workers") / "log"
    with (
        running("good", "tilted", "strict", endpoint=endpoint, log=log) as model,
        running("orchestrator", "none", "strict", endpoint=endpoint, log=log) as orchestrator,
    ):
        directory = Directory(session, task="plating")
        directory.wait_for("model", "tilted", timeout_s=START_S)
        directory.wait_for("orchestrator", timeout_s=START_S)
        directory.close()
        yield model, orchestrator


def request(**changes: object) -> dict[str, Any]:
    return {**PredictRequest.of(STATE, ACTIONS, content=True).model_dump(), "state": None, **changes}


def content(part: str, name: str, values: np.ndarray) -> dict[str, Any]:
    raw = request()
    raw["content"][part][name] = Array.of(values).model_dump()
    return raw


def optimize(**changes: object) -> dict[str, Any]:
    target = Array.of(STATE.scene.heights).model_dump()
    return {"state": StateMessage.of(STATE).model_dump(), "target": target, "evaluations": 1, **changes}


def without(raw: dict[str, Any], name: str) -> dict[str, Any]:
    return {key: value for key, value in raw.items() if key != name}


def heights(value: float) -> np.ndarray:
    found = STATE.scene.heights.copy()
    found[2, 3] = value
    return found


NAN, INFINITY = float("nan"), float("inf")
OTHER_GRID = {"rows": 10, "columns": 8, "cell": 0.01}
CORRUPT = {"dtype": "float32", "shape": [8, 10], "data": b"1234"}

BAD: dict[str, tuple[str, bytes, str, str]] = {
    "no payload": ("model", b"", "", "expected PredictRequest as the payload, got none"),
    "garbage": ("model", b"\xc1\xff\x00garbage", PACKED, "expected PredictRequest as MessagePack, got 10 other bytes"),
    "garbage without encoding": ("model", bytes(range(128, 256)), "", "expected PredictRequest as MessagePack"),
    "broken JSON": (
        "model",
        b'{"actions": ',
        "application/json",
        "expected PredictRequest as JSON, got 12 other bytes",
    ),
    "deep JSON": ("model", b"[" * 100_000, "application/json", "expected PredictRequest as JSON"),
    "a list": ("model", msgpack.packb([1, 2]), PACKED, "expected PredictRequest as a map, got list of 2"),
    "wrong schema": (
        "model",
        msgpack.packb({}),
        "application/msgpack;Card",
        "expected application/msgpack;PredictRequest",
    ),
    "missing field": ("model", msgpack.packb(without(request(), "actions")), PACKED, "actions: Field required"),
    "unknown field": ("model", msgpack.packb(request(extra=1)), PACKED, "extra: Extra inputs are not permitted"),
    "NaN heights": ("model", msgpack.packb(content("scene", "heights", heights(NAN))), PACKED, "1 that are NaN or inf"),
    "infinite heights": (
        "model",
        msgpack.packb(content("item", "heights", heights(INFINITY))),
        PACKED,
        "NaN or infinite",
    ),
    "heights of 3 m": (
        "model",
        msgpack.packb(content("scene", "heights", heights(3.0))),
        PACKED,
        "at most 1 m, got 3 m",
    ),
    "NaN actions": (
        "model",
        msgpack.packb(request(actions=Array.of(ACTIONS * NAN).model_dump())),
        PACKED,
        "actions: expected finite numbers",
    ),
    "wrong shape of heights": (
        "model",
        msgpack.packb(content("scene", "heights", np.zeros((8, 9)))),
        PACKED,
        "scene.heights: expected shape (8, 10), got (8, 9)",
    ),
    "wrong shape of actions": (
        "model",
        msgpack.packb(request(actions=Array.of(np.zeros(2)).model_dump())),
        PACKED,
        "actions: expected numbers of shape (B, n) with B from 1 to 32, got float64 of shape (2,)",
    ),
    "too many actions": (
        "model",
        msgpack.packb(request(actions=Array.of(np.zeros((33, 2))).model_dump())),
        PACKED,
        "with B from 1 to 32, got float64 of shape (33, 2)",
    ),
    "mismatched grids": (
        "model",
        msgpack.packb(content("item", "heights", np.ones((10, 8)))),
        PACKED,
        "item.heights: expected shape (8, 10), got (10, 8)",
    ),
    "another grid than the card's": (
        "model",
        msgpack.packb(
            request(content={**request()["content"], "grid": {**OTHER_GRID, "rows": 8, "columns": 10, "cell": 0.02}})
        ),
        PACKED,
        "grid: expected Grid(rows=8, columns=10, cell=0.01), got Grid(rows=8, columns=10, cell=0.02)",
    ),
    "a huge grid": (
        "model",
        msgpack.packb(
            request(content={**request()["content"], "grid": {"rows": 10**6, "columns": 10**6, "cell": 0.01}})
        ),
        PACKED,
        "expected a grid of at least 2 x 2",
    ),
    "data that do not fit their shape": (
        "model",
        msgpack.packb(request(actions=CORRUPT)),
        PACKED,
        "expected 320 bytes of data for shape (8, 10) and float32, got 4",
    ),
    "another state's digest": (
        "model",
        msgpack.packb(request(state="0" * 64)),
        PACKED,
        "expected the digest of 'content'",
    ),
    "an array of 200 MB": (
        "model",
        msgpack.packb(request(actions={"dtype": "float32", "shape": [50_000_000], "data": bytes(200_000_000)})),
        PACKED,
        "expected a payload of at most 67108864 bytes, got 2000",
    ),
    "0 evaluations": ("orchestrator", msgpack.packb(optimize(evaluations=0)), "", "evaluations: expected greater than"),
    "10^6 evaluations": (
        "orchestrator",
        msgpack.packb(optimize(evaluations=10**6)),
        "",
        "less than or equal to 5000, got 1000000",
    ),
    "empty bounds": (
        "orchestrator",
        msgpack.packb(optimize(bounds=[[0.0, 0.0], [0.0, 1.0]])),
        "",
        "bounds: expected low < high for parameter 0, got 0 and 0",
    ),
    "no bounds at all": (
        "orchestrator",
        msgpack.packb(optimize(bounds=[])),
        "",
        "bounds: Tuple should have at least 1 item",
    ),
    "a task that is no name": ("orchestrator", msgpack.packb(optimize(task="a/b")), "", "task: String should match"),
}


@pytest.mark.parametrize("name", BAD)
def test_bad_input_gets_a_clear_error_and_the_worker_serves_the_next_query(
    session: Session, workers: tuple[subprocess.Popen[bytes], ...], name: str
):
    who, payload, encoding, said = BAD[name]
    replies = list(session.get(KEYS[who], payload=payload, encoding=encoding or None, timeout=30))
    assert len(replies) == 1
    assert replies[0].err is not None
    error = decode(replies[0].err.payload.to_bytes(), str(replies[0].err.encoding), ErrorReply)
    assert error.code == "request"
    assert said in error.message
    assert len(error.message) < 600
    assert "Traceback" not in error.message
    good = PredictRequest.of(STATE, ACTIONS, content=True)
    assert ask(session, KEYS["model"], good, PredictReply, timeout_s=10).instance == "strict"
    assert all(process.poll() is None for process in workers)


def test_an_attachment_that_is_no_number_is_refused(session: Session, workers: tuple[subprocess.Popen[bytes], ...]):
    payload = msgpack.packb(request())
    reply = next(iter(session.get(KEYS["model"], payload=payload, encoding=PACKED, attachment="soon")))
    assert b"expected the remaining budget in seconds as text, got b'soon'" in reply.err.payload.to_bytes()
