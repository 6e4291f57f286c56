"""The way of docs/how-to/run-on-a-robot.md in the world's stand-in: ask, execute, report, fine-tune, promote."""

import json
import os
import shutil
import subprocess
import sys
from collections.abc import Iterator
from contextlib import ExitStack
from pathlib import Path

import numpy as np
import pytest
from conftest import START_S

from common.domain.grid import Grid
from common.storage.cases import read_cases
from common.wire import client
from common.wire.array import Array
from common.wire.directory import Directory
from common.wire.dispatch import Limits
from common.wire.keys import alias
from common.wire.optimization import OptimizeRequest
from common.wire.query import ask
from common.wire.remote import RemoteEstimator
from common.wire.report import TrialReply, TrialReport
from common.wire.serve_world import RemoteWorld
from common.wire.session import Session
from common.wire.state import StateMessage
from pipelines.data.depth_case import perceive
from services.heuristic import HeuristicModel
from tests.fakes import serving

ROOT = Path(__file__).parents[2]
TABLES = 4


@pytest.fixture
def system(
    endpoint: str, directory: Directory, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> Iterator[dict[str, str]]:
    """Start world, recorder, orchestrator, the heuristic and its MDE; return the environment of commands."""
    shutil.copytree(ROOT / "models" / "mde_heuristic", tmp_path / "models" / "mde_heuristic")
    monkeypatch.setenv("FRUGAL_MODELS", str(tmp_path / "models"))
    log = tmp_path / "log"
    with ExitStack() as stack:
        for arguments in (
            ("world",),
            ("recorder", "--folder", str(tmp_path / "trials")),
            ("orchestrator",),
            ("heuristic",),
            ("mde", "--model", "heuristic"),
        ):
            stack.enter_context(serving(*arguments, "--instance", "a", endpoint=endpoint, log=log))
        for role, model in (
            ("world", None),
            ("recorder", None),
            ("orchestrator", None),
            ("model", "heuristic"),
            ("mde", "heuristic"),
        ):
            directory.wait_for(role, model, timeout_s=4 * START_S)
        yield {**os.environ, "FRUGAL_CONNECT": endpoint}


def frugal(environment: dict[str, str], *arguments: str) -> subprocess.CompletedProcess[str]:
    command = [sys.executable, "-m", "services.cli.main", *arguments]
    done = subprocess.run(command, env=environment, capture_output=True, text=True, timeout=100, cwd=ROOT)
    assert done.returncode == 0, done.stderr
    return done


def test_a_robot_learns_from_what_it_did_and_its_mde_is_promoted_while_it_serves(
    system: dict[str, str], session: Session, directory: Directory, tmp_path: Path
):
    (served,) = directory.wait_for("world")
    world, acted = RemoteWorld(session, served.address), []
    for table in range(TABLES):
        seen = perceive(world.look(table), grid=Grid())
        wanted = HeuristicModel().predict(seen.state, np.array([[0.02, -0.01]])).heights[0]
        request = OptimizeRequest(
            state=StateMessage.of(seen.state), target=Array.of(wanted), strategy="only:heuristic", evaluations=8
        )
        answer = client.optimize(session, request, timeout_s=60)
        x, y = answer.action
        outcome = seen.outcome(world.execute(table, (x, y)))
        report = TrialReport(state=StateMessage.of(seen.state), action=(x, y), outcome=Array.of(outcome))
        told = ask(session, alias("plating", "trial/arm-1"), report, TrialReply, timeout_s=20)
        assert (told.robot, told.number) == ("arm-1", table + 1)
        acted.append((x, y))
    trials = str(tmp_path / "exported")
    frugal(system, "trials", "export", "--folder", str(tmp_path / "trials"), "--out", trials)
    assert [case.true_action for case in read_cases(Path(trials))] == acted
    tuned = str(tmp_path / "s2r")
    figures = json.loads(
        frugal(system, "finetune", "mde", "--model", "heuristic", "--trials", trials, "--out", tuned, "--json").stdout
    )
    remote, state = RemoteEstimator(directory, "heuristic", limits=Limits()), seen.state
    before = remote.estimate(state, np.zeros((1, 2)))
    frugal(system, "models", "promote", "mde_heuristic", tuned)
    after = remote.estimate(state, np.zeros((1, 2)))
    assert (before.version, after.version) == ("1", figures["version"])
    assert after.mean[0] != before.mean[0]
    assert after.familiar.all()
