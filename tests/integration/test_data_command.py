"""``frugal data`` in processes of its own: killed, resumed, with other numbers of workers, over Zenoh."""

import json
import os
import signal
import subprocess
import sys
import time
from contextlib import ExitStack
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from common.storage.cases import read_case
from common.storage.dataset import Dataset
from common.wire.client import list_workers
from common.wire.session import Session
from tests.fakes import free_endpoint, serving

ROOT = Path(__file__).parents[2]
OPTIONS = ("--name", "small", "--train", 9, "--test", 3, "--seed", 5, "--level", "coarse")


def start(*arguments: object, endpoint: str = "") -> subprocess.Popen[str]:
    command = [sys.executable, "-m", "services.cli.main", "data", *map(str, arguments)]
    environment = os.environ | {"FRUGAL_CONNECT": endpoint or free_endpoint()}
    return subprocess.Popen(
        command, cwd=ROOT, env=environment, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True
    )


def run(*arguments: object, endpoint: str = "") -> tuple[int, str, str]:
    process = start(*arguments, endpoint=endpoint)
    out, errors = process.communicate(timeout=100)
    return process.returncode, out, errors


def contents(path: Path) -> dict[str, bytes]:
    return {
        str(found.relative_to(path)): found.read_bytes() if found.is_file() else b""
        for found in sorted(path.rglob("*"))
        if found.name != "timings.jsonl"
    }


@pytest.fixture(scope="module")
def whole(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return the folder of a set that two processes made without an interruption."""
    out = tmp_path_factory.mktemp("whole")
    code, _, errors = run("generate", *OPTIONS, "--out", out, "--workers", 2)
    assert code == 0, errors
    return out


def test_one_worker_makes_the_same_bytes_as_two(whole: Path, tmp_path: Path):
    code, _, errors = run("generate", *OPTIONS, "--out", tmp_path, "--workers", 1)
    assert code == 0, errors
    assert contents(tmp_path / "small") == contents(whole / "small")


def test_a_kill_loses_no_sample_doubles_none_and_leaves_no_process(whole: Path, tmp_path: Path):
    process = start("generate", *OPTIONS, "--out", tmp_path)
    lines = tmp_path / "small" / "train" / "states.jsonl"
    deadline = time.monotonic() + 60
    while not lines.exists() or lines.read_bytes().count(b"\n") < 2:
        assert time.monotonic() < deadline
        time.sleep(0.01)
    children = Path(f"/proc/{process.pid}/task/{process.pid}/children").read_text().split()
    process.send_signal(signal.SIGKILL)
    process.communicate()
    there = lines.read_bytes()
    assert 2 <= there.count(b"\n") < 5
    while any(_is_running(child) for child in children):
        assert time.monotonic() < deadline
        time.sleep(0.05)
    with pytest.raises(Exception, match="expected a complete data set"):
        Dataset.open(tmp_path / "small")
    code, _, errors = run("generate", *OPTIONS, "--out", tmp_path)
    assert code == 0, errors
    assert contents(tmp_path / "small") == contents(whole / "small")
    timings = (tmp_path / "small" / "timings.jsonl").read_text().splitlines()
    made = [(line["split"], line["index"]) for line in map(json.loads, timings)]
    assert set(made) >= {("train", index) for index in range(5)} | {("test", index) for index in range(2)}
    assert len(made) <= len(set(made)) + 1


def _is_running(process: str) -> bool:
    try:
        return Path(f"/proc/{process}/stat").read_text().rsplit(")", 1)[1].split()[0] != "Z"
    except (FileNotFoundError, ProcessLookupError):
        return False


def test_workers_on_zenoh_make_the_same_bytes(whole: Path, tmp_path: Path, session: Session, endpoint: str):
    with ExitStack() as stack:
        for name in ("a", "b"):
            arguments = ("simulator", "--level", "coarse", "--instance", name)
            stack.enter_context(serving(*arguments, endpoint=endpoint, log=tmp_path / "log"))
        deadline = time.monotonic() + 60
        while len(list_workers(session)) < 2:
            assert time.monotonic() < deadline
        code, _, errors = run("generate", *OPTIONS, "--out", tmp_path, "--via", "zenoh", endpoint=endpoint)
    assert code == 0, errors
    assert contents(tmp_path / "small") == contents(whole / "small")


def test_a_set_is_drawn_and_its_card_is_printed(whole: Path, tmp_path: Path):
    code, out, errors = run("show", "--name", "small", "--data", whole, "--out", tmp_path / "sheet.png", "--json")
    assert code == 0, errors
    assert json.loads(out) == json.loads((whole / "small" / "card.json").read_text())
    with Image.open(tmp_path / "sheet.png") as image:
        assert min(image.size) > 500


@pytest.mark.parametrize(
    ("arguments", "expected"),
    [
        (("generate", "--name", "../up"), "expected a name of letters, digits, dots, dashes and underscores"),
        (("generate", "--name", "small", "--train", 0), "--train"),
        (("generate", "--name", "small", "--preset", "broad"), "'wide', 'narrow'"),
        (("generate", "--name", "small", "--level", "coarse", "--via", "zenoh", "--out", "{tmp}"), "expected a Zenoh"),
        (("generate", "--name", "small", "--out", "README.md"), "README.md"),
        (("generate", *OPTIONS, "--seed", 6, "--out", "{whole}"), "expected a data set with seed 6, got one with 5"),
        (("generate", "--name", "taken", "--out", "{tmp}"), "got a folder of something else"),
        (("show", "--name", "small", "--data", "{tmp}", "--json"), "expected a data set (frugal-dataset-1) in"),
        (("show", "--name", "small", "--data", "{whole}"), "expected --out for a figure or --json for the card"),
        (
            ("show", "--name", "small", "--data", "{whole}", "--out", "{tmp}/sheet.doc"),
            "--out: expected a file of .png",
        ),
    ],
)
def test_an_error_is_one_line_that_says_expected_and_got(arguments, expected: str, whole: Path, tmp_path: Path):
    (tmp_path / "taken").mkdir()
    (tmp_path / "taken" / "notes.txt").write_text("precious")
    places = {"{tmp}": str(tmp_path), "{whole}": str(whole), "{tmp}/sheet.doc": f"{tmp_path}/sheet.doc"}
    code, out, errors = run(*(places.get(argument, argument) for argument in arguments))
    assert code in (1, 2)
    assert out == ""
    assert expected in errors.splitlines()[-1]
    assert "Traceback" not in errors


ROWS, COLUMNS, FOCAL, DISTANCE = 240, 320, 350.0, 0.6
ITEM_RADIUS, ITEM_THICKNESS = 0.04, 0.016
RADIUS = (
    DISTANCE
    / FOCAL
    * np.hypot(np.arange(COLUMNS)[None, :] - (COLUMNS - 1) / 2, np.arange(ROWS)[:, None] - (ROWS - 1) / 2)
)


def images(folder: Path) -> list[str]:
    """Write what a camera straight above a flat table sees, with and without a disc, and return the options."""
    height = np.where(RADIUS < ITEM_RADIUS, ITEM_THICKNESS, 0.0)
    Image.fromarray(np.full((ROWS, COLUMNS), 1e3 * DISTANCE).astype(np.uint16)).save(folder / "before.png")
    Image.fromarray((1e3 * (DISTANCE - height)).round().astype(np.uint16)).save(folder / "after.png")
    np.save(folder / "item.npy", DISTANCE - height)
    np.save(folder / "plate.npy", np.full((ROWS, COLUMNS), DISTANCE))
    intrinsics = {"fx": FOCAL, "fy": FOCAL, "cx": (COLUMNS - 1) / 2, "cy": (ROWS - 1) / 2}
    (folder / "intrinsics.json").write_text(json.dumps(intrinsics))
    pose = [[1, 0, 0, 0], [0, -1, 0, 0], [0, 0, -1, DISTANCE], [0, 0, 0, 1]]
    (folder / "pose.json").write_text(json.dumps({"matrix": pose}))
    files = {"depth-before": "before.png", "depth-after": "after.png", "depth-item": "item.npy"}
    files |= {"depth-plate": "plate.npy", "intrinsics": "intrinsics.json", "pose": "pose.json", "out": "trial.npz"}
    options = [part for name, file in files.items() for part in (f"--{name}", str(folder / file))]
    return [*options, "--item-material", "1050", "3e4", "0.4", "--action", "0", "0"]


def test_depth_images_become_a_case(tmp_path: Path):
    code, _, errors = run("import", *images(tmp_path))
    assert code == 0, errors
    case = read_case(tmp_path / "trial.npz")
    volume = float(case.state.item.heights.sum()) * case.state.grid.cell**2
    assert volume == pytest.approx(np.pi * ITEM_RADIUS**2 * ITEM_THICKNESS, rel=0.1)
    assert case.target.max() == pytest.approx(ITEM_THICKNESS, abs=0.001)
    assert case.true_action == (0.0, 0.0)


def _no_numbers(folder: Path) -> None:
    (folder / "intrinsics.json").write_text('{"fx": 1}')


def _wide_pose(folder: Path) -> None:
    (folder / "pose.json").write_text("[[1, 2], [3, 4]]")


def _no_json(folder: Path) -> None:
    (folder / "pose.json").write_text("1 0 0 0")


def _eight_bits(folder: Path) -> None:
    Image.fromarray(np.zeros((ROWS, COLUMNS), np.uint8)).save(folder / "before.png")


def _no_image(folder: Path) -> None:
    (folder / "before.png").write_bytes(b"no image")


def _no_file(folder: Path) -> None:
    (folder / "item.npy").unlink()


def _three_numbers(folder: Path) -> None:
    np.save(folder / "item.npy", np.zeros((4, 4, 3)))


def _other_unit(folder: Path) -> None:
    np.save(folder / "item.npy", np.full((ROWS, COLUMNS), 600.0))


@pytest.mark.parametrize(
    ("spoil", "expected"),
    [
        (_no_numbers, "expected fx, fy, cx and cy, got no fy, cx, cy"),
        (_wide_pose, "expected a 4 x 4 matrix"),
        (_no_json, "pose.json: expected JSON"),
        (_eight_bits, "expected 16 bits of grey a pixel, got mode L"),
        (_no_image, "before.png: expected a PNG"),
        (_no_file, "expected a depth image at"),
        (_three_numbers, "item.npy: expected one number a pixel"),
        (_other_unit, "check intrinsics, pose and the unit of the depths"),
    ],
)
def test_an_image_or_camera_that_cannot_be_is_refused_in_one_line(tmp_path: Path, spoil, expected: str):
    options = images(tmp_path)
    spoil(tmp_path)
    code, _, errors = run("import", *options)
    assert code == 1
    assert expected in errors.splitlines()[-1]
    assert "Traceback" not in errors
    assert not (tmp_path / "trial.npz").exists()
