"""``frugal train learned`` and ``frugal evaluate models`` in processes of their own."""

import json
import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from common.learning.weights import CARD, read_card
from tests.mde_fakes import write_dataset

ROOT = Path(__file__).parents[2]


def run(*arguments: object) -> subprocess.CompletedProcess[str]:
    command = [sys.executable, "-m", "services.cli.main", *map(str, arguments)]
    environment = {**os.environ, "OMP_NUM_THREADS": "1"}
    return subprocess.run(command, cwd=ROOT, env=environment, capture_output=True, text=True, timeout=110, check=False)


@pytest.fixture(scope="module")
def data(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("data") / "small"
    write_dataset(folder)
    return folder


@pytest.fixture(scope="module")
def weights(data: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    out = tmp_path_factory.mktemp("models") / "learned"
    done = run("train", "learned", "--data", data, "--out", out, "--epochs", 1, "--folds", 2, "--threads", 1)
    assert done.returncode == 0, done.stderr
    assert done.stdout == ""
    assert "on 8 test samples, heuristic" in done.stderr.splitlines()[-1]
    return out


def test_training_leaves_weights_a_card_and_cross_fitted_deviations(weights: Path):
    card = read_card(weights, name="learned")
    assert card.settings["training"]["epochs"] == 1
    with np.load(weights / "deviations.npz") as file:
        assert file["deviation_m"].shape == (32,)
        assert file["test_deviation_m"].shape == (8,)
        assert set(file["fold"]) == {1, 2}


def test_table_1_of_trained_weights_is_json_and_raw_results(data: Path, weights: Path, tmp_path: Path):
    done = run("evaluate", "models", "--data", data, "--learned", weights, "--fine", 0, "--out", tmp_path, "--json")
    assert done.returncode == 0, done.stderr
    table = json.loads(done.stdout)
    assert table == json.loads((tmp_path / "models.json").read_text())
    assert set(table) == {"heuristic", "learned"}
    metrics = read_card(weights).metrics
    assert table["learned"]["rmse_m"] == pytest.approx(metrics["test_rmse_m"])
    assert table["heuristic"]["rmse_m"] == pytest.approx(metrics["heuristic_test_rmse_m"])
    assert {"rmse_m", "rmse_std_m", "latency_p50_s", "latency_p95_s"} <= table["learned"].keys()
    assert len((tmp_path / "measurements.jsonl").read_text().splitlines()) == 2 * (8 + 1)


def test_wrong_data_weights_and_options_are_told_in_one_line(data: Path, weights: Path, tmp_path: Path):
    (tmp_path / CARD).write_text("{}")
    for arguments, complaint in (
        (("train", "learned", "--data", tmp_path / "nothing"), "expected a data set"),
        (("train", "learned", "--data", data, "--folds", 1), "expected 0 or at least 2 folds, got 1"),
        (("evaluate", "models", "--data", data, "--learned", tmp_path), "Field required"),
    ):
        done = run(*arguments)
        assert done.returncode != 0
        assert complaint in done.stderr.splitlines()[-1]
        assert "Traceback" not in done.stderr
