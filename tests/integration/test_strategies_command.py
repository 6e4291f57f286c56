"""``frugal evaluate strategies`` with the simulator, as a person or a program calls it."""

import json
import os
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
FIGURES = ("error_median_m", "error_mean_m", "reward_regret_m", "simulator_calls", "wall_s")


def frugal(*arguments: object) -> subprocess.CompletedProcess[str]:
    command = [sys.executable, "-m", "services.cli.main", "evaluate", "strategies", *map(str, arguments)]
    environment = os.environ | {"FRUGAL_MODELS": str(ROOT / "no-models"), "COLUMNS": "100"}
    return subprocess.run(command, cwd=ROOT, env=environment, capture_output=True, text=True, timeout=110, check=False)


def test_a_row_for_each_strategy_and_figures_come_out_and_a_finished_run_is_not_run_again(tmp_path: Path):
    options = ("--targets", 2, "--evaluations", 4, "--strategy", "fast", "--jitter", 2, "--workers", 2)
    done = frugal(*options, "--out", tmp_path, "--json")
    assert done.returncode == 0, done.stderr
    rows = {row["strategy"]: row for row in json.loads(done.stdout)}
    assert list(rows) == ["only:simulator", "only:simulator, 2 calls", "only:simulator, 3 calls", "fast"]
    for row in rows.values():
        for name in FIGURES:
            assert {"value", "low", "high", "difference", "difference_low", "difference_high"} <= set(row[name])
    assert rows["fast"]["simulator_calls"]["value"] == 2
    assert rows["fast"]["jitter_reward_m"]["value"] < 0
    for name in ("development-pareto.png", "development-sweeps.png"):
        assert (tmp_path / name).read_bytes().startswith(b"\x89PNG")
    raw = (tmp_path / "development.jsonl").read_text()
    again = frugal(*options, "--out", tmp_path, "--json")
    assert json.loads(again.stdout) == json.loads(done.stdout)
    assert (tmp_path / "development.jsonl").read_text() == raw


@pytest.mark.parametrize(
    ("arguments", "expected"),
    [
        (("--set", "mdes"), "expected an MDE to replace, got none"),
        (("--strategy", "best"), "strategy: expected one of"),
        (("--strategy", "fast+luck"), "expected one of"),
        (("--jitter", "3"), "expected an even number"),
    ],
)
def test_an_error_is_one_line_that_says_expected_and_got(arguments: tuple[str, ...], expected: str, tmp_path: Path):
    done = frugal(*arguments, "--out", tmp_path / "new")
    assert done.returncode == 1
    assert expected in done.stderr
    assert "Traceback" not in done.stderr
    assert not (tmp_path / "new").exists()
