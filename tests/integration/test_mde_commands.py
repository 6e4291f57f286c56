"""`frugal train mde` and `frugal evaluate mdes` on a small data set."""

import json
import subprocess
import sys
from pathlib import Path

import pytest

from common.storage.dataset import Dataset
from services.mde.estimator import read_estimator
from tests.mde_fakes import write_dataset

ROOT = Path(__file__).parents[2]


@pytest.fixture(scope="module")
def dataset(tmp_path_factory: pytest.TempPathFactory) -> Dataset:
    return write_dataset(tmp_path_factory.mktemp("data") / "small")


def frugal(*arguments: object) -> subprocess.CompletedProcess[str]:
    command = [sys.executable, "-m", "services.cli.main", *map(str, arguments)]
    return subprocess.run(command, cwd=ROOT, capture_output=True, text=True, timeout=110, check=False)


def test_a_model_in_a_file_of_ones_own_gets_an_mde_without_any_code_for_it(dataset: Dataset, tmp_path: Path):
    model = "examples/fourth_model.py:RestingModel"
    done = frugal("train", "mde", "--model", model, "--data", dataset.path, "--out", tmp_path / "mde", "--epochs", 1)
    assert done.returncode == 0, done.stderr
    assert "MAE" in done.stderr
    estimator = read_estimator(tmp_path / "mde", model="resting")
    samples = dataset.samples("test")
    estimates = estimator.estimate(dataset.state("test", 0), samples.actions[:2])
    assert estimates.mean.shape == (2,)
    assert estimator.model == "resting"


def test_mdes_prints_every_figure_by_model_and_variant_as_json(dataset: Dataset, tmp_path: Path):
    options = ("--data", dataset.path, "--out", tmp_path, "--model", "heuristic", "--seeds", 1, "--epochs", 1)
    done = frugal("evaluate", "mdes", *options, "--json")
    assert done.returncode == 0, done.stderr
    table = json.loads(done.stdout)
    assert set(table["heuristic"]) == {"crop", "crop_upper", "paper", "paper_upper"}
    for name in ("mae", "median_baseline_mae", "auroc", "false_accept_rate", "recall", "coverage", "d_max", "seeds"):
        assert name in table["heuristic"]["crop"]
    assert json.loads((tmp_path / "mdes.json").read_text()) == table
    assert len((tmp_path / "judgements.jsonl").read_text().splitlines()) == 2 * 9
    assert (tmp_path / "reliability.png").stat().st_size > 10_000


@pytest.mark.parametrize(
    ("arguments", "complaint"),
    [
        (("train", "mde", "--model", "heuristic", "--data", "nowhere"), "expected a data set"),
        (("train", "mde", "--model", "nobody"), "expected"),
        (("serve", "mde", "--model", "nobody"), "got no such file"),
        (("evaluate", "mdes", "--data", "nowhere"), "expected a data set"),
    ],
)
def test_an_error_is_one_line(arguments: tuple[str, ...], complaint: str):
    done = frugal(*arguments)
    assert done.returncode == 1
    assert complaint in done.stderr.splitlines()[-1]
    assert "Traceback" not in done.stderr


def test_a_model_that_is_no_model_is_named(dataset: Dataset, tmp_path: Path):
    done = frugal("train", "mde", "--model", "nobody", "--data", dataset.path, "--out", tmp_path)
    assert done.returncode == 1
    assert "expected heuristic, learned, simulator_coarse or FILE.py:CLASS, got 'nobody'" in done.stderr
