"""Plating with yaw over spawned workers: what cards say, what is answered and refused, and what is found."""

import json
import os
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import ExitStack
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from common.domain.case import Case
from common.domain.errors import RequestError
from common.storage.cases import write_case
from common.storage.dataset import Dataset
from common.tasks import TASKS
from common.wire import client
from common.wire.array import Array
from common.wire.directory import Directory
from common.wire.dispatch import Limits
from common.wire.messages import PredictReply, PredictRequest
from common.wire.optimization import OptimizeRequest
from common.wire.query import ask
from common.wire.remote import RemoteEstimator, RemoteModel
from common.wire.session import Session, open_session
from common.wire.settings import WireSettings
from common.wire.state import StateMessage
from services.heuristic import HeuristicModel
from services.mde.estimator import read_estimator
from tests.fakes import free_endpoint, running, serving
from tests.mde_fakes import write_dataset, write_weights

ROOT = Path(__file__).parents[2]
TASK = TASKS["plating_yaw"]
QUICK = str(ROOT / "tests" / "served_models.py") + ":QuickSimulator"
TRUE_ACTION = (0.012, -0.008, 2.9)
ACTIONS = np.array([[0.01, -0.015, 0.5], [-0.02, 0.02, -2.0], [0.01, 0.01, 0.5]])


class System:
    """Router, orchestrator, heuristic and quick simulator, all of ``plating_yaw``; a test adds the heuristic's MDE."""

    def __init__(self, stack: ExitStack, folder: Path) -> None:
        self._stack, self._log, self.endpoint = stack, folder / "log", free_endpoint()
        stack.enter_context(running("router", endpoint=self.endpoint, log=self._log))
        for arguments in (("orchestrator",), ("heuristic",), ("model", QUICK)):
            self.serve(*arguments)
        self.session: Session = stack.enter_context(open_session(WireSettings(connect=(self.endpoint,)), wait_s=30))
        self.directory = Directory(self.session, task=TASK.name)
        stack.callback(self.directory.close)
        self.wait_for({"orchestrator/a", "heuristic/a", "simulator/a"})

    def serve(self, *arguments: str) -> None:
        command = (*arguments, "--task", TASK.name, "--instance", "a")
        self._stack.enter_context(serving(*command, endpoint=self.endpoint, log=self._log))

    def wait_for(self, names: set[str]) -> None:
        deadline = time.monotonic() + 80
        while not names <= {status.address.worker for status in client.list_workers(self.session)}:
            assert time.monotonic() < deadline, self._log.read_text()
            time.sleep(0.05)


@pytest.fixture(scope="module")
def system(tmp_path_factory: pytest.TempPathFactory) -> Iterator[System]:
    with ExitStack() as stack:
        yield System(stack, tmp_path_factory.mktemp("system"))


@pytest.fixture(scope="module")
def dataset(tmp_path_factory: pytest.TempPathFactory) -> Dataset:
    return write_dataset(tmp_path_factory.mktemp("data") / "small")


@pytest.fixture(scope="module")
def case(dataset: Dataset) -> Case:
    """Return a case whose target no action of plating reaches."""
    state = dataset.state("test", 0)
    target = TASK.adapt_model(HeuristicModel()).predict(state, np.array([TRUE_ACTION])).heights[0]
    return Case("turned", 0, state, target, TRUE_ACTION, True, task=TASK.name)


def test_cards_name_the_parameters(system: System):
    cards = [status.card for status in client.list_workers(system.session)]
    assert len(cards) == 3
    assert {card.parameters for card in cards if card is not None} == {("x", "y", "yaw")}


def test_a_worker_answers_a_turned_action_as_the_model_in_this_process_does(system: System, case: Case):
    remote = RemoteModel(system.directory, "heuristic", limits=Limits())
    expected = TASK.adapt_model(HeuristicModel()).predict(case.state, ACTIONS)
    np.testing.assert_array_equal(remote.predict(case.state, ACTIONS).heights, expected.heights)


@pytest.mark.parametrize("count", [1, 2, 4])
def test_a_request_with_another_number_of_parameters_is_refused(system: System, case: Case, count: int):
    request = PredictRequest.of(case.state, np.zeros((2, count)), content=True)
    key = f"frugal/@v1/{TASK.name}/model/heuristic/a/predict"
    with pytest.raises(RequestError, match=rf"expected 3 \(x, y, yaw\) parameters each, got {count}"):
        ask(system.session, key, request, PredictReply, timeout_s=20)


@pytest.mark.parametrize("strategy", ["quality", "threshold"])
def test_an_optimisation_finds_a_turned_target(system: System, case: Case, strategy: str):
    request = OptimizeRequest(
        task=TASK.name,
        state=StateMessage.of(case.state),
        target=Array.of(case.target),
        strategy=strategy,
        evaluations=50,
    )
    result = client.optimize(system.session, request, timeout_s=200).result()
    x, y, yaw = np.subtract(result.action, TRUE_ACTION)
    assert np.hypot(x, y) < 2e-3
    # The item of this data set looks nearly the same after half a turn.
    assert abs((yaw + np.pi / 2) % np.pi - np.pi / 2) < 0.1
    assert -result.reward < 0.25 * abs(float(TASK.reward(case.state.scene.heights, case.target)))


def test_the_bounds_have_to_be_those_of_three_parameters(system: System, case: Case):
    request = OptimizeRequest(
        task=TASK.name,
        state=StateMessage.of(case.state),
        target=Array.of(case.target),
        bounds=((-0.01, 0.01), (-0.01, 0.01)),
    )
    with pytest.raises(RequestError, match="expected 3 action parameters, got 2"):
        client.optimize(system.session, request, timeout_s=20)


def frugal(*arguments: object, endpoint: str) -> subprocess.CompletedProcess[str]:
    return subprocess.run(
        [sys.executable, "-m", "services.cli.main", *map(str, arguments)],
        cwd=ROOT,
        env=os.environ | {"FRUGAL_CONNECT": endpoint, "FRUGAL_LISTEN": endpoint},
        capture_output=True,
        text=True,
        timeout=200,
        check=False,
    )


def test_the_command_line_asks_for_the_case_s_task_and_reports_the_yaw(system: System, case: Case, tmp_path: Path):
    write_case(tmp_path / "turned.npz", case)
    done = frugal(
        "optimize", tmp_path / "turned.npz", "--strategy", "fast", "--out", tmp_path / "out", endpoint=system.endpoint
    )
    assert done.returncode == 0, done.stderr
    assert len(done.stdout.split()) == 3
    assert "turned by" in done.stderr
    summary = json.loads((tmp_path / "out" / "result.json").read_text())
    assert len(summary["action"]) == len(summary["true_action"]) == 3
    assert summary["action_error_m"] < 0.01
    assert 0 <= summary["other_errors"]["yaw_error_rad"] <= np.pi
    assert (tmp_path / "out" / "placement.png").exists()


def test_a_case_of_plating_can_be_asked_with_yaw(system: System, case: Case, tmp_path: Path):
    flat = HeuristicModel().predict(case.state, np.array([TRUE_ACTION[:2]])).heights[0]
    write_case(tmp_path / "flat.npz", replace(case, target=flat, true_action=TRUE_ACTION[:2], task="plating"))
    options = ("--strategy", "fast", "--json", "--task", TASK.name)
    done = frugal("optimize", tmp_path / "flat.npz", *options, endpoint=system.endpoint)
    assert done.returncode == 0, done.stderr
    summary = json.loads(done.stdout)
    assert summary["true_action"] == [*TRUE_ACTION[:2], 0.0]
    assert summary["settings"]["task"] == TASK.name


def test_an_mde_estimates_turned_actions_and_its_estimates_lead(
    system: System, dataset: Dataset, case: Case, tmp_path: Path
):
    write_weights(tmp_path / "mde_heuristic", dataset)
    system.serve("mde", "--model", "heuristic", "--weights", str(tmp_path / "mde_heuristic"))
    local = TASK.adapt_estimator(read_estimator(tmp_path / "mde_heuristic", model="heuristic"))
    system.wait_for({"mde/heuristic/a"})
    found = RemoteEstimator(system.directory, "heuristic", limits=Limits()).estimate(case.state, ACTIONS)
    expected = local.estimate(case.state, ACTIONS)
    np.testing.assert_allclose(found.mean, expected.mean, atol=1e-6)
    np.testing.assert_array_equal(found.familiar, expected.familiar)
    request = OptimizeRequest(
        task=TASK.name,
        state=StateMessage.of(case.state),
        target=Array.of(case.target),
        strategy="threshold",
        evaluations=4,
    )
    trials = client.optimize(system.session, request, timeout_s=60).trials
    assert all(0 <= trial.estimates["heuristic"] <= 1 for trial in trials)
