"""What people and robots do with a record of trials: report, list, show, export."""

import json
import os
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest

from common.domain.case import Case
from common.storage.cases import read_case, read_cases, write_case
from common.storage.dataset_cases import samples_of_cases
from common.wire.session import Session
from tests.fakes import make_state, serving
from tests.recorder_fakes import a_report, wait_for_recorder

ROOT = Path(__file__).parents[2]


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("trials_command") / "trials"


@pytest.fixture(scope="module")
def own(tmp_path_factory: pytest.TempPathFactory) -> Iterator[list[Path]]:
    """Case files of two executed actions."""
    paths = [tmp_path_factory.mktemp("own") / f"{number}.npz" for number in range(2)]
    for number, path in enumerate(paths):
        report = a_report(number)
        case = Case("own", 0, report.state.state(), report.outcome.values(), report.action, True, "by hand")
        write_case(path, case)
    return paths


@pytest.fixture(scope="module", autouse=True)
def recorded(endpoint: str, session: Session, folder: Path, own: list[Path]) -> Iterator[list[str]]:
    """What the command printed about one trial of arm-1 and one of arm-2."""
    log = folder.with_name("log")
    with (
        pytest.MonkeyPatch.context() as environment,
        serving("recorder", "--folder", str(folder), "--instance", "r", endpoint=endpoint, log=log),
    ):
        environment.setenv("FRUGAL_CONNECT", endpoint)
        environment.setenv("FRUGAL_TRIALS", str(folder))
        wait_for_recorder(session, log)
        robots = ("arm-1", "arm-2")
        yield [
            run("trials", "report", path, "--robot", robot, "--id", robot).stdout
            for path, robot in zip(own, robots, strict=True)
        ]


def run(*arguments: object, expected: int = 0, **environment: str) -> subprocess.CompletedProcess[str]:
    command = [sys.executable, "-m", "services.cli.main", *map(str, arguments)]
    done = subprocess.run(
        command, cwd=ROOT, capture_output=True, text=True, timeout=60, check=False, env=os.environ | environment
    )
    assert done.returncode == expected, done.stderr
    assert "Traceback" not in done.stderr
    return done


def test_a_report_is_acknowledged_with_number_and_file_and_alike_when_it_comes_again(
    recorded: list[str], folder: Path, own: list[Path]
):
    assert [line.split()[0] for line in recorded] == ["1", "2"]
    assert {line.split()[1] for line in recorded} <= {path.name for path in folder.iterdir()}
    again = json.loads(run("trials", "report", own[0], "--robot", "arm-1", "--id", "arm-1", "--json").stdout)
    assert f"{again['number']} {again['file']}\n" == recorded[0]


def test_a_report_that_the_recorder_refuses_is_one_line_and_no_success(own: list[Path], tmp_path: Path):
    done = run("trials", "report", own[0], "--robot", "arm-2", expected=1)
    assert done.stdout == ""
    assert "request: expected a new trial, got a duplicate: trial 1, reported by arm-1 as arm-1" in done.stderr
    state = make_state()
    write_case(tmp_path / "other.npz", Case("other", 0, state, state.scene.heights, None, False))
    done = run("trials", "report", tmp_path / "other.npz", "--robot", "arm-1", expected=1)
    assert "expected a case whose target was made with its own item and action" in done.stderr


def test_the_list_has_every_trial_for_people_and_for_programs(recorded: list[str]):
    lines = run("trials", "list", COLUMNS="80").stdout.splitlines()
    assert lines[0].split() == ["number", "robot", "received", "item", "action,", "mm", "cm3", "added", "digest"]
    assert [line.split()[:2] for line in lines[1:3]] == [["1", "arm-1"], ["2", "arm-2"]]
    trials = json.loads(run("trials", "list", "--json").stdout)
    assert lines[1].split()[4:] == ["soft", "+10.0", "-10.0", "6", "6", trials[0]["digest"][:8]]
    assert [f"{trial['number']} {trial['file']}\n" for trial in trials[:2]] == recorded
    assert trials[0]["action"] == [0.01, -0.01]
    assert trials[0]["item_volume"] == pytest.approx(6e-6, rel=0.1)


def test_a_trial_is_drawn(tmp_path: Path):
    run("trials", "show", 2, "--out", tmp_path / "trial.svg")
    drawn = (tmp_path / "trial.svg").read_text()
    for title in ("Scene", "Item", "Outcome", "Outcome - scene", "trial 2 of arm-2"):
        assert f"<!-- {title}" in drawn
    assert "expected the number of a trial in" in run("trials", "show", 9, "--out", "x.png", expected=1).stderr


def test_trials_are_exported_as_case_files_that_fine_tuning_reads(folder: Path, own: list[Path], tmp_path: Path):
    run("trials", "export", "--out", tmp_path / "all")
    run("trials", "export", "--out", tmp_path / "two", "--robot", "arm-2")
    cases = read_cases(tmp_path / "all")
    assert {path.name for path in (tmp_path / "all").iterdir()} == {path.name for path in folder.glob("*.npz")}
    np.testing.assert_array_equal(samples_of_cases(cases).outcomes[0], read_case(own[0]).target)
    (only,) = read_cases(tmp_path / "two")
    assert only.name == "arm-2-arm-2"
    assert (
        "expected trials of nobody"
        in run("trials", "export", "--out", tmp_path / "none", "--robot", "nobody", expected=1).stderr
    )
    assert "expected another folder" in run("trials", "export", "--out", folder, expected=1).stderr


def test_a_damaged_trial_is_told_and_left_out_of_an_export(folder: Path, tmp_path: Path):
    copied = tmp_path / "copied"
    run("trials", "export", "--out", copied)
    first, second = sorted(copied.iterdir())[:2]
    content = bytearray(first.read_bytes())
    place = content.index(b"target.npy") + 80
    content[place] ^= 0xFF
    first.write_bytes(content)
    done = run("trials", "export", "--folder", copied, "--out", tmp_path / "whole", expected=1)
    assert f"left out: {first}" in done.stderr
    assert second.name in {path.name for path in (tmp_path / "whole").iterdir()}
    assert not (tmp_path / "whole" / first.name).exists()


def test_a_robot_without_our_code_reports_a_trial(folder: Path, own: list[Path], tmp_path: Path):
    case = read_case(own[0])
    fresh = tmp_path / "fresh.npz"
    write_case(fresh, Case("fresh", 0, case.state, case.target + np.float32(1e-4), case.true_action, True, "new"))
    command = [sys.executable, "examples/report_trial.py", "robot-7", str(fresh)]
    done = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, timeout=60, check=False)
    assert done.returncode == 0, done.stderr
    kept = read_case(folder / done.stdout.split()[1])
    assert kept.state.digest == case.state.digest
    assert kept.true_action == case.true_action
    assert kept.notes == "new"
    again = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, timeout=60, check=False)
    assert again.returncode == 1
    assert "refused: expected a new trial, got a duplicate" in again.stderr


def test_the_example_imports_nothing_but_zenoh_and_msgpack():
    code = (
        "import sys; sys.path.insert(0, 'examples'); import report_trial\n"
        "assert not {'numpy', 'pydantic', 'common', 'services', 'click'} & set(sys.modules)\n"
    )
    done = subprocess.run([sys.executable, "-c", code], cwd=ROOT, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
