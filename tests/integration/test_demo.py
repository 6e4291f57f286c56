"""The demonstration: the whole system with the real simulator, once."""

import json
import os
import subprocess
import sys
from contextlib import suppress
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]


@pytest.mark.timeout(300)
def test_the_demo_writes_its_results_and_leaves_no_process(tmp_path: Path):
    command = [sys.executable, "-m", "services.cli.main", "demo", "04-medallion-bare"]
    done = subprocess.run(
        [*command, "--evaluations", "10", "--out", str(tmp_path / "demo")],
        cwd=ROOT,
        env=os.environ | {"DEMO_MARK": str(tmp_path)},
        capture_output=True,
        text=True,
        timeout=280,
        check=False,
    )
    assert done.returncode == 0, done.stderr
    assert "all processes stopped" in done.stderr
    result = json.loads((tmp_path / "demo" / "result.json").read_text())
    assert 1 <= result["usage"]["simulator"] <= 10  # fewer where the last calls gained nothing
    assert result["usage"]["heuristic"] > 100  # its sweep over the plate
    assert result["action_error_m"] < 0.05
    assert result["usage"]["learned"] > 10  # where the heuristic points
    assert {"heuristic", "learned", "simulator", "mde", "optimiser", "transport"} == set(result["split_s"])
    trials = [json.loads(line) for line in (tmp_path / "demo" / "trials.jsonl").read_text().splitlines()]
    assert len(trials) == result["usage"]["simulator"]
    assert all(trial["instance"] in ("simulator-1", "simulator-2") for trial in trials)
    assert (tmp_path / "demo" / "placement.png").stat().st_size > 10_000
    logs = {path.stem for path in (tmp_path / "demo" / "logs").iterdir()}
    networks = {"learned", "mde-heuristic", "mde-learned"}
    assert logs == {"router", "heuristic", "simulator-1", "simulator-2", "orchestrator", *networks}
    assert processes_with(str(tmp_path)) == []


def processes_with(mark: str) -> list[str]:
    """Return the commands of the processes that carry a mark in their environment."""
    found: list[str] = []
    for process in Path("/proc").glob("[0-9]*"):
        with suppress(OSError):
            if f"DEMO_MARK={mark}".encode() in (process / "environ").read_bytes():
                found.append((process / "cmdline").read_bytes().replace(b"\0", b" ").decode())
    return found
