"""``frugal evaluate <experiment>`` and ``frugal report``, from a file of two targets to the document."""

import json
import os
import subprocess
import sys
from pathlib import Path

import pytest

from common.domain.case import Case
from common.domain.grid import Grid
from common.storage.cases import write_case
from pipelines.cases import BUNDLED, make_case
from services.heuristic import HeuristicModel
from services.simulator.settle import settle_boxes

ROOT = Path(__file__).parents[2]
TINY = """
title = "Two targets"
of = "No figure"
order = 1
view = "usage"
about = "The heuristic evaluates {heuristic.heuristic} actions."

[measurements.optimise]
kind = "optimise"
cases = { trials = ["tiny-v1/test"] }
family = ["heuristic"]
methods = ["only:heuristic"]
evaluations = 4

[[series]]
key = "heuristic"
label = "Only Heuristic"
method = "only:heuristic"
"""


def frugal(folder: Path, *arguments: object) -> subprocess.CompletedProcess[str]:
    command = [sys.executable, "-m", "services.cli.main", *map(str, arguments), "--raw", str(folder / "raw")]
    environment = os.environ | {"PYTHONPATH": str(ROOT), "COLUMNS": "100"}
    return subprocess.run(
        command, cwd=folder, env=environment, capture_output=True, text=True, timeout=110, check=False
    )  # fmt: skip


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    """Two trials, and an experiment on them beside one that is never measured."""
    trials = tmp_path / "data" / "tiny-v1" / "test"
    trials.mkdir(parents=True)
    for recipe in BUNDLED[:2]:
        case: Case = make_case(recipe, settle=settle_boxes, model=HeuristicModel(), grid=Grid())
        write_case(trials / f"{case.name}.npz", case)
    (tmp_path / "experiments").mkdir()
    (tmp_path / "experiments" / "tiny.toml").write_text(TINY)
    never = TINY.replace("order = 1", "order = 2").replace("evaluations = 4", "evaluations = 5")
    (tmp_path / "experiments" / "never.toml").write_text(never)
    return tmp_path


def test_an_experiment_is_measured_once_and_reported_with_what_is_missing(folder: Path):
    experiments = ("--experiments", folder / "experiments")
    done = frugal(folder, "evaluate", *experiments, "tiny", "--workers", 1)
    assert done.returncode == 0, done.stderr
    (path,) = (folder / "raw").glob("optimise-*/raw.jsonl")
    header, *rows = map(json.loads, path.read_text().splitlines())
    assert [len(row["trials"]) for row in rows] == [4, 4]
    assert [row["seed"] for row in rows] == [0, 1]
    assert header["measurement"]["parameters"]["evaluations"] == 4

    before = path.read_bytes()
    assert frugal(folder, "evaluate", *experiments, "tiny").returncode == 0
    assert path.read_bytes() == before

    report = frugal(folder, "report", *experiments, "--partial", "--json", "--out", folder / "docs")
    assert report.returncode == 0, report.stderr
    (number,) = json.loads(report.stdout)
    assert (number["key"], number["value"], number["samples"]) == ("heuristic.heuristic", 4, 2)
    assert "left out: never" in report.stderr
    document = (folder / "docs" / "results.md").read_text()
    assert "The heuristic evaluates 4.00 actions." in document
    assert (folder / "docs" / "figures" / "tiny.png").is_file()

    whole = frugal(folder, "report", *experiments, "--out", folder / "docs")
    assert whole.returncode == 1
    assert "never: expected raw results in" in whole.stderr
    assert "run `frugal evaluate never`" in whole.stderr


@pytest.mark.parametrize(
    ("arguments", "expected"),
    [
        (("nothing",), "No such command 'nothing'"),
        (("--all", "tiny"), "expected --all, --list or a name"),
        (("--data", "nowhere", "tiny"), "nowhere/tiny-v1: expected a data set or trials of this name, got none"),
    ],
)
def test_a_wrong_request_is_one_line(folder: Path, arguments: tuple[str, ...], expected: str):
    command = [sys.executable, "-m", "services.cli.main", "evaluate", "--experiments", str(folder / "experiments")]
    done = subprocess.run(
        [*command, *arguments], cwd=folder, env=os.environ | {"PYTHONPATH": str(ROOT), "COLUMNS": "200"},
        capture_output=True, text=True, timeout=110, check=False,
    )  # fmt: skip
    assert done.returncode != 0
    assert expected in done.stderr
    assert "Traceback" not in done.stderr
