"""``frugal bench simulator`` and ``frugal simulate``, as a person or a program calls them."""

import json
import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from common.storage.cases import read_case
from services.simulator.settings import LEVELS

ROOT = Path(__file__).parents[2]
SCENE = "04-medallion-bare"

FIGURES = (
    "soft_median_s",
    "soft_p95_s",
    "rigid_median_s",
    "batch_settles_per_s_per_core",
    "settled_share",
    "verified_share",
    "penetration_median_m",
    "penetration_max_m",
    "default_vs_fine_rms_median_m",
    "default_vs_fine_rms_p95_m",
    "default_vs_fine_rms_median_all_m",
    "path_sensitivity_share",
    "shift_100um_rms_median_m",
    "shift_1mm_rms_median_all_m",
    "vbd_time_ratio",
    "memory",
)


def frugal(*arguments: object) -> subprocess.CompletedProcess[str]:
    command = [sys.executable, "-m", "services.cli.main", *map(str, arguments)]
    return subprocess.run(
        command, cwd=ROOT, env=os.environ | {"COLUMNS": "100"}, capture_output=True, text=True, timeout=110, check=False
    )


def test_the_figures_of_a_benchmark_are_one_json_object_with_seed_version_and_settings(tmp_path: Path):
    records = tmp_path / "new" / "records.jsonl"
    done = frugal(
        "bench", "simulator", "--scenes", 2, "--compare", 1, "--no-peers", "--json", "--seed", 3, "--records", records
    )
    assert done.returncode == 0, done.stderr
    figures = json.loads(done.stdout)
    assert set(FIGURES) <= set(figures)
    assert (figures["scenes"], figures["seed"], figures["device"]) == (2, 3, "cpu")
    assert figures["vbd_time_ratio"] is None
    assert set(figures["levels"]) == set(figures["settings"]) == set(LEVELS)
    assert figures["levels"]["fine"]["vs_fine_rms_median_all_m"] == 0
    assert figures["penetration_max_m"] < 2e-3
    lines = [json.loads(line) for line in records.read_text().splitlines()]
    assert [line["index"] for line in lines] == [0, 1]
    assert set(lines[0]["levels"]) == set(LEVELS)


def test_without_json_the_figures_are_a_table():
    done = frugal("bench", "simulator", "--scenes", 1, "--compare", 0, "--no-peers", "--level", "coarse")
    assert done.returncode == 0, done.stderr
    assert "level coarse" in done.stdout
    assert "at rest, verified" in done.stdout


def test_a_simulated_placement_is_a_heightmap_a_strip_of_frames_and_a_result(tmp_path: Path):
    done = frugal("simulate", SCENE, "--action", 0.01, -0.02, "--level", "coarse", "--out", tmp_path / "new")
    assert done.returncode == 0, done.stderr
    case = read_case(ROOT / "examples" / "scenes" / f"{SCENE}.npz")
    result = json.loads((tmp_path / "new" / "result.json").read_text())
    assert result["settled"]
    assert result["action"] == [0.01, -0.02]
    assert result["model"] == "simulator_coarse"
    with np.load(tmp_path / "new" / "heightmap.npz") as file:
        assert file["heights"].shape == case.state.grid.shape
        assert file["cell"] == case.state.grid.cell
    assert (tmp_path / "new" / "frames.png").read_bytes().startswith(b"\x89PNG")


@pytest.mark.parametrize(
    ("arguments", "expected"),
    [
        (("simulate", "no-such-scene", "--out", "out/none"), "expected a case file or one of"),
        (("simulate", SCENE), "Missing option '--out'"),
        (("simulate", SCENE, "--action", "0.5", "0", "--out", "out/none"), "expected actions on the grid"),
        (("simulate", SCENE, "--level", "finest", "--out", "out/none"), "'finest' is not one of"),
        (("bench", "simulator", "--scenes", "0"), "--scenes"),
        (("bench", "simulator", "--device", "nowhere", "--scenes", "1"), "nowhere"),
    ],
)
def test_an_error_is_one_line_that_says_expected_and_got(arguments: tuple[str, ...], expected: str):
    done = frugal(*arguments)
    assert done.returncode in (1, 2)
    assert expected in done.stderr
    assert "Traceback" not in done.stderr
    assert not (ROOT / "out" / "none").exists()


def test_a_step_of_the_optimiser_is_measured_beside_scikit_learn_and_botorch_in_the_same_run():
    done = frugal("bench", "optimizer", "--seeds", 1, "--json")
    assert done.returncode == 0, done.stderr
    figures = json.loads(done.stdout)
    assert {"overhead_ms_at_50", "sklearn_ms_at_50", "botorch_ms_at_50"} <= set(figures)
    assert figures["botorch_ratio"] > 10
    assert figures["overhead_processor_ms_at_50"] > 0
    assert figures["planner_processor_ms_at_50"] > 0
