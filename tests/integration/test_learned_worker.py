"""The learned model as a process: what it serves, and what it refuses to serve."""

import json
import os
import shutil
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from conftest import START_S

from common.domain.errors import UnavailableError
from common.domain.grid import Grid
from common.domain.scene import Item, Scene, State
from common.learning.weights import CARD, TENSORS
from common.wire.directory import Directory
from common.wire.dispatch import Limits
from common.wire.remote import RemoteModel
from services.learned.model import LearnedModel
from tests.fakes import serving
from tests.learned_fakes import GRID, save_learned

ROOT = Path(__file__).parents[2]
ACTIONS = np.array([[0.01, -0.015], [-0.05, 0.02], [0.03, 0.03]])


def make_state(grid: Grid) -> State:
    rng = np.random.default_rng(0)
    inside = (np.abs(grid.x[None, :]) < 0.03) & (np.abs(grid.y[:, None]) < 0.02)
    fries = rng.random(grid.shape) < 0.1
    material = np.array([1000.0, 1e5, 0.4], dtype=np.float32)[:, None, None]
    scene = Scene(grid, (0.01 * fries).astype(np.float32), material * fries)
    return State(scene, Item((0.02 * inside).astype(np.float32), material * inside))


@pytest.fixture(scope="module")
def weights(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("models") / "learned"
    save_learned(folder)
    return folder


def test_a_worker_answers_what_its_weights_do_and_its_card_names_them(
    directory: Directory, endpoint: str, weights: Path, tmp_path: Path
):
    local, state = LearnedModel.load(weights), make_state(GRID)
    options = ("learned", "--weights", str(weights), "--instance", "w")
    with serving(*options, endpoint=endpoint, log=tmp_path / "log"):
        (worker,) = directory.wait_for("model", "learned", timeout_s=2 * START_S)
        found = RemoteModel(directory, "learned", limits=Limits()).predict(state, ACTIONS)
        with pytest.raises(UnavailableError, match=r"model learned that takes Grid\(rows=64"):
            RemoteModel(directory, "learned", limits=Limits()).predict(make_state(Grid(64, 64, 0.003)), ACTIONS)
    np.testing.assert_array_equal(found.heights, local.predict(state, ACTIONS).heights)
    assert (found.instance, found.version) == ("w", "7")
    assert worker.card is not None
    assert worker.card.weights == json.loads((weights / CARD).read_text())["sha256"]
    assert worker.card.grid is not None
    assert worker.card.grid.grid() == GRID


def spoil_card(folder: Path, **fields: object) -> None:
    path = folder / CARD
    path.write_text(json.dumps(json.loads(path.read_text()) | fields))


LIES: dict[str, tuple[Callable[[Path], object], str]] = {
    "wrong sha256": (lambda folder: spoil_card(folder, sha256="0" * 64), "expected SHA-256 0000"),
    "wrong grid": (
        lambda folder: spoil_card(folder, grid={"rows": 96, "columns": 96, "cell": 0.003}),
        "expected a card with the grid of the weights, Grid(rows=48, columns=48, cell=0.005), got Grid(rows=96",
    ),
    "another model": (lambda folder: spoil_card(folder, name="mde_learned"), "expected weights of learned"),
    "another network": (lambda folder: spoil_card(folder, architecture="x"), "expected a network of the architecture"),
    "cut off": (lambda folder: os.truncate(folder / TENSORS, 1000), "expected SHA-256"),
    "nothing there": (lambda folder: (folder / CARD).unlink(), "got no such file"),
}


@pytest.mark.parametrize("lie", LIES)
def test_a_worker_refuses_weights_that_are_not_what_their_card_says(weights: Path, tmp_path: Path, lie: str):
    spoil, complaint = LIES[lie]
    folder = shutil.copytree(weights, tmp_path / "copy")
    spoil(folder)
    command = [sys.executable, "-m", "services.cli.main", "serve", "learned", "--weights", str(folder)]
    done = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, timeout=100, check=False)
    assert done.returncode == 1
    assert complaint in done.stderr.splitlines()[-1]
    assert "Traceback" not in done.stderr
