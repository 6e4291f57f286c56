"""`frugal finetune mde` and `frugal finetune next` on a few trials."""

import json
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from common.storage.cases import write_case
from services.mde.estimator import read_estimator
from tests.mde_fakes import make_trials, small_settings, write_dataset, write_weights

ROOT = Path(__file__).parents[2]


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return a folder with the MDE ``base`` of the heuristic, 6 trials and one scene."""
    folder = tmp_path_factory.mktemp("kitchen")
    write_weights(folder / "base", write_dataset(folder / "small"), small_settings())
    (folder / "trials").mkdir()
    for case in make_trials(6, shift_m=0.0002):
        write_case(folder / "trials" / f"{case.name}.npz", case)
    (folder / "scene").mkdir()
    write_case(folder / "scene" / "scene.npz", make_trials(1, first=6)[0])
    return folder


def finetune(*arguments: object) -> subprocess.CompletedProcess[str]:
    command = [sys.executable, "-m", "services.cli.main", "finetune", *map(str, arguments)]
    return subprocess.run(command, cwd=ROOT, capture_output=True, text=True, timeout=110, check=False)


def test_an_mde_is_fine_tuned_on_a_folder_of_trials_and_serves(folder: Path, tmp_path: Path):
    options = ("--model", "heuristic", "--base", folder / "base", "--trials", folder / "trials")
    done = finetune("mde", *options, "--iterations", 200, "--out", tmp_path, "--json")
    assert done.returncode == 0, done.stderr
    told = json.loads(done.stdout)
    before, after = told["metrics"]["before"]["mae"], told["metrics"]["held_out"]["mae"]
    assert after < before
    assert f"MAE {before:.3f} before, {after:.3f} after" in done.stderr.splitlines()[-1]
    assert told["finetuning"]["method"] == "last"
    estimator, case = read_estimator(tmp_path, model="heuristic"), make_trials(6, shift_m=0.0002)[0]
    assert estimator.version == told["version"]
    assert estimator.weights == told["sha256"]
    assert estimator.estimate(case.state, np.array([case.true_action])).familiar.all()


@pytest.mark.parametrize("acquisition", ["representative", "random", "lcb", "variance", "integrated"])
def test_the_next_actions_lie_within_the_bounds_and_are_the_same_again(folder: Path, acquisition: str):
    options = ("--model", "heuristic", "--base", folder / "base", "--trials", folder / "trials", "--steps", 5)
    question = ("next", *options, "--scene", folder / "scene" / "scene.npz", "--acquisition", acquisition, "--count", 3)
    first, second = finetune(*question, "--json"), finetune(*question)
    assert first.returncode == second.returncode == 0, first.stderr + second.stderr
    actions = np.array([one["action"] for one in json.loads(first.stdout)])
    assert actions.shape == (3, 2)
    assert (np.abs(actions) <= 0.08).all()
    assert len(np.unique(actions, axis=0)) == 3
    printed = [[float(value) for value in line.split()] for line in second.stdout.splitlines()]
    np.testing.assert_allclose(printed, actions, atol=1e-6)


def test_an_action_is_proposed_before_the_first_trial_and_for_what_will_be_met(folder: Path):
    options = ("--model", "heuristic", "--base", folder / "base", "--scene", folder / "scene" / "scene.npz")
    done = finetune("next", *options, "--acquisition", "integrated", "--steps", 4, "--reference", folder / "scene")
    assert done.returncode == 0, done.stderr
    assert len(done.stdout.split()) == 2


def test_an_error_is_one_line(folder: Path, tmp_path: Path):
    empty, unknown = tmp_path / "empty", tmp_path / "unknown"
    empty.mkdir()
    unknown.mkdir()
    write_case(unknown / "one.npz", replace(make_trials(1)[0], true_action=None))
    out = ("--model", "heuristic", "--out", tmp_path / "out")
    scene = ("--model", "heuristic", "--scene", folder / "scene" / "scene.npz")
    for arguments, complaint in (
        (("mde", *out, "--base", folder / "base", "--trials", empty), "expected case files (*.npz)"),
        (("mde", *out, "--base", folder / "base", "--trials", unknown), "expected a case with its own item's action"),
        (("mde", *out, "--base", tmp_path / "nowhere", "--trials", folder / "trials"), "got no such file"),
        (("mde", *out, "--trials", folder / "trials"), "trials: expected Grid(rows=96"),
        (("next", *scene), "scene: expected"),
    ):
        done = finetune(*arguments)
        assert done.returncode == 1
        assert complaint in done.stderr.splitlines()[-1]
        assert "Traceback" not in done.stderr
    assert not (tmp_path / "out").exists()
