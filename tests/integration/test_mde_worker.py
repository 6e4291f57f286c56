"""MDE workers as processes: what they serve, what they refuse, and what the orchestrator makes of their estimates."""

import json
import os
import shutil
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import ExitStack
from pathlib import Path

import numpy as np
import pytest

from common.domain.grid import Grid
from common.domain.scene import Item, Scene, State
from common.domain.trial import Result
from common.storage.dataset import Dataset
from common.wire import client
from common.wire.array import Array
from common.wire.directory import Directory
from common.wire.dispatch import Limits
from common.wire.optimization import OptimizeRequest
from common.wire.remote import RemoteEstimator
from common.wire.session import Session, open_session
from common.wire.settings import WireSettings
from common.wire.state import StateMessage
from services.heuristic import HeuristicModel
from services.mde.estimator import read_estimator
from tests.fakes import free_endpoint, running, serving
from tests.mde_fakes import write_dataset, write_weights

ROOT = Path(__file__).parents[2]
ACTIONS = np.array([[0.01, -0.015], [-0.05, 0.02], [0.03, 0.03]])
QUICK = str(ROOT / "tests" / "served_models.py") + ":QuickSimulator"


@pytest.fixture(scope="module")
def dataset(tmp_path_factory: pytest.TempPathFactory) -> Dataset:
    return write_dataset(tmp_path_factory.mktemp("data") / "small")


@pytest.fixture(scope="module")
def weights(dataset: Dataset, tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("weights") / "mde_heuristic"
    write_weights(folder, dataset)
    return folder


class System:
    """Router, orchestrator, a heuristic and a quick simulator; tests add an MDE of the heuristic."""

    def __init__(self, stack: ExitStack, folder: Path) -> None:
        self.log, self.endpoint = folder / "log", free_endpoint()
        stack.enter_context(running("router", endpoint=self.endpoint, log=self.log))
        for arguments in (("orchestrator",), ("heuristic",), ("model", QUICK)):
            self.serve(stack, *arguments, "--instance", "a")
        self.session: Session = stack.enter_context(open_session(WireSettings(connect=(self.endpoint,)), wait_s=20))
        self.wait_for({"orchestrator/a", "heuristic/a", "simulator/a"})

    def serve(self, stack: ExitStack, *arguments: str) -> None:
        stack.enter_context(serving(*arguments, endpoint=self.endpoint, log=self.log))

    def wait_for(self, names: set[str]) -> None:
        self._wait(lambda live: names <= live)

    def wait_until_gone(self, name: str) -> None:
        self._wait(lambda live: name not in live)

    def optimize(self, state: State, **options: object) -> Result:
        target = HeuristicModel().predict(state, np.array([[0.012, -0.008]])).heights[0]
        fields = {
            "state": StateMessage.of(state),
            "target": Array.of(target),
            "strategy": "threshold",
            "evaluations": 16,
        }
        fields |= options
        return client.optimize(self.session, OptimizeRequest.model_validate(fields), timeout_s=60).result()

    def _wait(self, is_so: Callable[[set[str]], bool]) -> None:
        deadline = time.monotonic() + 30
        while not is_so({status.address.worker for status in client.list_workers(self.session)}):
            assert time.monotonic() < deadline, self.log.read_text()
            time.sleep(0.02)


@pytest.fixture(scope="module")
def system(tmp_path_factory: pytest.TempPathFactory) -> Iterator[System]:
    with ExitStack() as stack:
        yield System(stack, tmp_path_factory.mktemp("system"))


@pytest.fixture
def with_mde(system: System, weights: Path) -> Iterator[System]:
    """Return the system with the trained MDE."""
    with ExitStack() as stack:
        system.serve(stack, "mde", "--model", "heuristic", "--weights", str(weights), "--instance", "m")
        system.wait_for({"mde/heuristic/m"})
        yield system
    system.wait_until_gone("mde/heuristic/m")


@pytest.fixture
def with_radius(system: System) -> Iterator[System]:
    """Return the system with a fake MDE whose estimate grows with the distance from the plate's centre."""
    with running("mde", "heuristic", "r", endpoint=system.endpoint, log=system.log):
        system.wait_for({"mde/heuristic/r"})
        yield system
    system.wait_until_gone("mde/heuristic/r")


def test_a_worker_estimates_what_its_weights_do_and_its_card_names_them(
    with_mde: System, dataset: Dataset, weights: Path
):
    state, local = dataset.state("test", 0), read_estimator(weights, model="heuristic", threads=1)
    directory = Directory(with_mde.session, task="plating")
    try:
        (worker,) = directory.wait_for("mde", "heuristic", timeout_s=10)
        remote = RemoteEstimator(directory, "heuristic", limits=Limits())
        found, expected = remote.estimate(state, ACTIONS), local.estimate(state, ACTIONS)
    finally:
        directory.close()
    np.testing.assert_allclose(found.mean, expected.mean, atol=1e-6)
    np.testing.assert_allclose(found.upper, expected.upper, atol=1e-6)
    np.testing.assert_array_equal(found.familiar, expected.familiar)
    assert found.reason == expected.reason
    assert found.scale_m == expected.scale_m is not None
    assert worker.card is not None
    assert worker.card.weights == json.loads((weights / "card.json").read_text())["sha256"]


def spoil_card(folder: Path, **fields: object) -> None:
    path = folder / "card.json"
    path.write_text(json.dumps(json.loads(path.read_text()) | fields))


LIES: dict[str, tuple[Callable[[Path], object], str]] = {
    "wrong sha256": (lambda folder: spoil_card(folder, sha256="0" * 64), "expected SHA-256 0000"),
    "wrong grid": (lambda f: spoil_card(f, grid={"rows": 96, "columns": 96, "cell": 0.003}), "grid: expected 64 x 64"),
    "another model": (lambda folder: spoil_card(folder, name="mde_learned"), "expected weights of mde_heuristic"),
    "cut off": (lambda f: os.truncate(f / "weights.safetensors", 1000), "expected SHA-256"),
    "nothing there": (lambda folder: (folder / "card.json").unlink(), "got no such file"),
}


@pytest.mark.parametrize("lie", LIES)
def test_a_worker_refuses_weights_that_are_not_what_their_card_says(weights: Path, tmp_path: Path, lie: str):
    spoil, complaint = LIES[lie]
    folder = shutil.copytree(weights, tmp_path / "copy")
    spoil(folder)
    command = [sys.executable, "-m", "services.cli.main", "serve", "mde", "--model", "heuristic"]
    done = subprocess.run(
        [*command, "--weights", str(folder)], cwd=ROOT, capture_output=True, text=True, timeout=60, check=False
    )
    assert done.returncode == 1
    assert complaint in done.stderr.splitlines()[-1]
    assert "Traceback" not in done.stderr


@pytest.mark.parametrize("in_flight", [1, 4])
def test_one_optimisation_uses_the_cheap_model_where_it_is_applicable_and_the_simulator_elsewhere(
    with_radius: System, dataset: Dataset, in_flight: int
):
    result = with_radius.optimize(dataset.state("test", 0), in_flight=in_flight)
    assert set(result.usage) == {"heuristic", "simulator"}
    for trial in result.trials:
        mean = min(10 * float(np.hypot(*trial.action)), 1.0)
        assert trial.estimates["heuristic"] == pytest.approx(mean)
        assert trial.model == ("heuristic" if mean < 0.4 else "simulator")
    assert result.split_s["mde"] > 0


def test_a_threshold_on_the_upper_bound_is_a_setting_of_the_request(with_radius: System, dataset: Dataset):
    result = with_radius.optimize(dataset.state("test", 0), strategy="threshold:upper", evaluations=40)
    for trial in result.trials:
        assert trial.model == ("heuristic" if trial.uppers["heuristic"] < 0.4 else "simulator")
    assert any(trial.estimates["heuristic"] < 0.4 <= trial.uppers["heuristic"] for trial in result.trials)


def another_grid() -> State:
    grid = Grid(40, 44, 0.006)
    item = np.where((np.abs(grid.x[None, :]) < 0.03) & (np.abs(grid.y[:, None]) < 0.02), 0.015, 0.0).astype(np.float32)
    materials = np.where(item > 0, np.array([1050.0, 1e5, 0.4])[:, None, None], 0).astype(np.float32)
    return State(Scene(grid, np.zeros(grid.shape, np.float32), np.zeros_like(materials)), Item(item, materials))


def too_stiff(state: State) -> State:
    materials = state.item.materials.copy()
    materials[1][materials[1] > 0] = 1e7
    return State(state.scene, Item(state.item.heights, materials))


def another_plate(state: State) -> State:
    raised = Scene(state.grid, state.scene.heights + np.float32(0.01), state.scene.materials)
    return State(raised, state.item)


UNFAMILIAR: dict[str, tuple[Callable[[State], State], str]] = {
    "another grid": (lambda state: another_grid(), "grid: expected"),
    "another plate": (another_plate, "plate: expected"),
    "a stiffness never seen": (too_stiff, "Young's modulus"),
}


@pytest.mark.parametrize("kind", UNFAMILIAR)
def test_an_unfamiliar_state_is_answered_by_the_simulator_and_the_result_says_so(
    with_mde: System, dataset: Dataset, kind: str
):
    make, reason = UNFAMILIAR[kind]
    result = with_mde.optimize(make(dataset.state("train", 0)), d_max=1.0, evaluations=6)
    assert result.usage == {"simulator": 6}
    assert all(trial.unfamiliar == ("heuristic",) for trial in result.trials)
    (event,) = [event for event in result.events if event.kind == "unfamiliar"]
    assert event.worker == "mde/heuristic"
    assert reason in event.detail
