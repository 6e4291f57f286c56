"""A robot's software and a person with a plain Zenoh client get the same answer as the command line."""

import base64
import json
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import ExitStack
from pathlib import Path

import numpy as np
import pytest
import zenoh

from common.domain.case import Case
from common.storage.cases import write_case
from common.wire.client import list_workers
from common.wire.optimization import OptimizeRequest
from common.wire.session import Session, open_session
from common.wire.settings import WireSettings
from services.cli.optimize import make_request
from services.heuristic import HeuristicModel
from tests.fakes import free_endpoint, make_state, running, serving

ROOT = Path(__file__).parents[2]
TRUE_ACTION = (0.012, -0.006)


@pytest.fixture(scope="module")
def case() -> Case:
    state = make_state(3, bodies=True)
    target = HeuristicModel().predict(state, np.array([TRUE_ACTION])).heights[0]
    return Case("robot", 3, state, target, TRUE_ACTION, True)


@pytest.fixture(scope="module")
def session(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Session]:
    endpoint, log = free_endpoint(), tmp_path_factory.mktemp("robot") / "log"
    model = f"{ROOT / 'tests' / 'served_models.py'}:QuickSimulator"
    with ExitStack() as stack:
        stack.enter_context(running("router", endpoint=endpoint, log=log))
        stack.enter_context(serving("model", model, endpoint=endpoint, log=log))
        stack.enter_context(serving("orchestrator", endpoint=endpoint, log=log))
        settings = WireSettings(connect=(endpoint,))
        session = stack.enter_context(open_session(settings, wait_s=20))
        deadline = time.monotonic() + 30
        while len(list_workers(session)) < 2:
            assert time.monotonic() < deadline, log.read_text()
            time.sleep(0.05)
        stack.enter_context(pytest.MonkeyPatch.context()).setenv("FRUGAL_CONNECT", endpoint)
        yield session


def run(*command: object) -> str:
    done = subprocess.run([sys.executable, *map(str, command)], cwd=ROOT, capture_output=True, text=True, timeout=60)
    assert done.returncode == 0, done.stderr
    return done.stdout


@pytest.mark.usefixtures("session")
def test_a_robots_query_and_the_command_line_get_the_same_best_action(case: Case, tmp_path: Path):
    path = tmp_path / "case.npz"
    write_case(path, case)
    from_command = run("-m", "services.cli.main", "optimize", path, "--seed", 0)
    assert run("examples/query_from_robot.py", path) == from_command
    x, y = map(float, from_command.split())
    assert np.hypot(x - TRUE_ACTION[0], y - TRUE_ACTION[1]) < 2e-3


@pytest.mark.usefixtures("session")
def test_the_command_line_writes_result_trials_and_figure(case: Case, tmp_path: Path):
    path, out = tmp_path / "case.npz", tmp_path / "out"
    write_case(path, case)
    printed = json.loads(run("-m", "services.cli.main", "optimize", path, "--json", "--out", out, "--evaluations", 12))
    assert printed == json.loads((out / "result.json").read_text())
    wanted = ["action", "action_error_m", "reward", "evaluations", "usage", "wall_s", "split_s", "seed", "models"]
    assert set(wanted) <= set(printed)
    assert 2 <= printed["evaluations"] == sum(printed["usage"].values()) <= 12
    assert {"simulator", "mde", "optimiser", "transport"} <= set(printed["split_s"])
    assert printed["action_error_m"] == pytest.approx(np.hypot(*np.subtract(printed["action"], TRUE_ACTION)))
    trials = [json.loads(line) for line in (out / "trials.jsonl").read_text().splitlines()]
    assert [trial["index"] for trial in trials] == list(range(printed["evaluations"]))
    assert max(trial["reward"] for trial in trials) == printed["reward"]
    assert (out / "placement.png").stat().st_size > 10_000
    assert "<svg" in (out / "placement.svg").read_text()


def test_a_plain_zenoh_get_with_json_is_answered_in_json(session: Session, case: Case):
    request = make_request(case, evaluations=12)
    answers = []
    for payload in (request.model_dump_json(), request.model_copy(update={"id": "again"}).model_dump_json()):
        (reply,) = session.get("frugal/@v1/plating/optimize", payload=payload, timeout=30.0)
        assert reply.ok is not None, reply.err
        assert reply.ok.encoding == zenoh.Encoding.APPLICATION_JSON
        answers.append(json.loads(reply.ok.payload.to_bytes()))
    assert answers[0]["action"] == answers[1]["action"]
    heights = answers[0]["heights"]
    assert len(base64.b64decode(heights["data"])) == 4 * np.prod(heights["shape"])


@pytest.mark.parametrize(
    ("payload", "reason"),
    [
        (b"\x00\xff garbage", "expected OptimizeRequest as MessagePack"),
        (b'{"task": "plating"}', "state: Field required"),
        (b"[1, 2]", "OptimizeRequest"),
        (b'{"state": 3, "target": 4}', "state"),
    ],
)
def test_garbage_is_refused_with_a_reason_and_the_next_query_served(
    session: Session, case: Case, payload: bytes, reason: str
):
    (reply,) = session.get("frugal/@v1/plating/optimize", payload=payload, timeout=30.0)
    assert reply.err is not None
    assert reason.encode() in reply.err.payload.to_bytes()
    request: OptimizeRequest = make_request(case, evaluations=3)
    (reply,) = session.get("frugal/@v1/plating/optimize", payload=request.model_dump_json(), timeout=30.0)
    assert reply.ok is not None


def test_an_unknown_task_is_answered_with_the_known_one(session: Session, case: Case):
    payload = make_request(case, task="cooking").model_dump_json()
    (reply,) = session.get("frugal/@v1/cooking/optimize", payload=payload, timeout=30.0)
    assert reply.err is not None
    assert "task: expected plating, got frugal/@v1/cooking/optimize" in reply.err.payload.to_string()
