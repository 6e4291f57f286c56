import json

import numpy as np
import pytest

from common.domain.bodies import Bodies
from common.domain.case import Case
from common.domain.errors import RequestError
from common.domain.grid import Grid
from common.domain.scene import Item, Scene, State
from common.storage.cases import read_case, read_cases, write_case
from common.tasks.plating_sampler import sample_state


def a_case(**changes):
    state = sample_state(np.random.default_rng(7), Grid(), settle=lambda plate, boxes: tuple(boxes))
    values = {
        "name": "one",
        "seed": 7,
        "state": state,
        "target": state.scene.heights + np.float32(0.01),
        "true_action": (0.012345678901, -0.02),
        "same_item": True,
        "notes": "Für alle.",
    }
    return Case(**(values | changes))


def test_a_case_comes_back_as_it_was_written(tmp_path):
    case = a_case()
    write_case(tmp_path / "one.npz", case)
    back = read_case(tmp_path / "one.npz")
    assert back.state.digest == case.state.digest
    assert (back.target == case.target).all()
    for name in ("name", "seed", "true_action", "same_item", "notes"):
        assert getattr(back, name) == getattr(case, name)
    assert list(tmp_path.iterdir()) == [tmp_path / "one.npz"]


def test_a_case_of_another_task_says_so_and_one_without_a_task_is_of_plating(tmp_path):
    turned = a_case(task="plating_yaw", true_action=(0.01, 0.02, 3.0))
    write_case(tmp_path / "turned.npz", turned)
    write_case(tmp_path / "plain.npz", a_case())
    assert read_case(tmp_path / "turned.npz").task == "plating_yaw"
    assert read_case(tmp_path / "turned.npz").true_action == (0.01, 0.02, 3.0)
    with np.load(tmp_path / "plain.npz") as file:
        assert "task" not in json.loads(str(file["about"]))
    assert read_case(tmp_path / "plain.npz").task == "plating"


@pytest.mark.parametrize("known", ["nothing", "boxes only", "no box"])
def test_what_is_known_of_the_bodies_survives(tmp_path, known):
    scene, item = a_case().state.scene, a_case().state.item
    bodies = {
        "nothing": None,
        "boxes only": Bodies(None, scene.bodies.boxes),
        "no box": Bodies(scene.bodies.plate, ()),
    }[known]
    case = a_case(state=State(Scene(scene.grid, scene.heights, scene.materials, bodies), item))
    write_case(tmp_path / "one.npz", case)
    assert read_case(tmp_path / "one.npz").state.digest == case.state.digest


def test_equal_cases_make_equal_bytes_of_at_most_100_kilobytes(tmp_path):
    for name in ("a", "b"):
        write_case(tmp_path / f"{name}.npz", a_case())
    content = (tmp_path / "a.npz").read_bytes()
    assert content == (tmp_path / "b.npz").read_bytes()
    assert len(content) < 100_000


def test_a_folder_is_read_in_the_order_of_the_names(tmp_path):
    for name in ("b", "a"):
        write_case(tmp_path / f"{name}.npz", a_case(name=name))
    assert [case.name for case in read_cases(tmp_path)] == ["a", "b"]


def test_a_folder_without_cases_is_refused(tmp_path):
    with pytest.raises(RequestError, match="expected case files"):
        read_cases(tmp_path)


def test_only_a_target_of_the_same_item_has_a_reference_action():
    assert a_case().reference_action == (0.012345678901, -0.02)
    assert a_case(same_item=False).reference_action is None


def _without(name):
    def spoil(arrays):
        del arrays[name]

    return spoil


def _with(name, value):
    def spoil(arrays):
        arrays[name] = value

    return spoil


def _about(**changes):
    def spoil(arrays):
        arrays["about"] = np.array(json.dumps(json.loads(str(arrays["about"])) | changes))

    return spoil


@pytest.mark.parametrize(
    ("spoil", "message"),
    [
        (_without("target"), "expected a case with the array or field 'target'"),
        (_with("target", np.zeros((4, 4))), r"target: expected shape \(96, 96\), got \(4, 4\)"),
        (_with("target", np.full((96, 96), np.nan)), "target: expected finite numbers"),
        (_with("scene_heights", np.zeros(96)), r"scene_heights: expected shape \(H, W\), got \(96,\)"),
        (_with("boxes", np.zeros((2, 12))), "boxes: expected 13 numbers each"),
        (_with("about", np.array("{")), "expected a case file"),
        (_with("about", np.array("[]")), "expected a case file"),
        (_about(format="frugal-case-0"), "its format is 'frugal-case-0'"),
        (_about(cell=-1), "expected a cell between"),
        (_about(cell="wide"), "expected a case file"),
        (_about(true_action=[float("nan"), 0]), "true_action: expected finite numbers"),
    ],
)
def test_a_spoilt_file_is_refused_with_its_name_and_what_was_expected(tmp_path, spoil, message):
    path = tmp_path / "one.npz"
    write_case(path, a_case())
    with np.load(path) as file:
        arrays = dict(file)
    spoil(arrays)
    np.savez_compressed(path, **arrays)
    with pytest.raises(RequestError, match=message) as caught:
        read_case(path)
    assert "one.npz" in str(caught.value)


@pytest.mark.parametrize("content", [b"", b"no zip at all", b"PK\x03\x04broken"])
def test_a_file_that_is_no_archive_is_refused(tmp_path, content):
    (tmp_path / "one.npz").write_bytes(content)
    with pytest.raises(RequestError, match="expected a case file"):
        read_case(tmp_path / "one.npz")


def test_a_file_with_one_damaged_byte_is_read_or_refused_and_nothing_else(tmp_path):
    grid, path = Grid(4, 4, 0.02), tmp_path / "one.npz"
    heights = np.zeros(grid.shape, dtype=np.float32)
    item, materials = heights + np.float32(0.01), np.full((3, *grid.shape), 0.4, dtype=np.float32)
    state = State(Scene(grid, heights, materials), Item(item, materials))
    write_case(path, Case("one", 0, state, item, (0.0, 0.0), True))
    whole = path.read_bytes()
    refused = 0
    for place in range(0, len(whole), 11):
        path.write_bytes(whole[:place] + bytes([whole[place] ^ 0x2D]) + whole[place + 1 :])
        try:
            read_case(path)
        except RequestError:
            refused += 1
    assert refused > 40


def test_a_plain_array_is_refused(tmp_path):
    with (tmp_path / "one.npz").open("wb") as file:
        np.save(file, np.zeros(3))
    with pytest.raises(RequestError, match="expected a case file"):
        read_case(tmp_path / "one.npz")


def test_a_missing_file_is_refused(tmp_path):
    with pytest.raises(RequestError, match="does not exist"):
        read_case(tmp_path / "none.npz")
