import multiprocessing

import pytest
from dataset_fakes import Restless, contents, made, plan, write

from common.domain.errors import RequestError, UnavailableError
from common.storage.dataset import Dataset
from common.storage.dataset_writer import DatasetWriter


@pytest.mark.parametrize("order", [reversed, lambda states: [*states[1::2], *states[::2]]])
def test_the_order_in_which_states_come_leaves_no_trace(tmp_path, order):
    write(tmp_path / "first")
    write(tmp_path / "second", order=order)
    assert contents(tmp_path / "first") == contents(tmp_path / "second")


def test_states_beyond_the_wanted_number_of_samples_leave_no_trace(tmp_path):
    write(tmp_path / "first")
    write(tmp_path / "second", order=lambda states: [*states, len(states), len(states) + 1])
    assert contents(tmp_path / "first") == contents(tmp_path / "second")


def test_a_state_that_is_there_is_not_written_again(tmp_path):
    with DatasetWriter(tmp_path / "set", plan()) as writer:
        writer.add("train", made("train", 0))
        before = contents(tmp_path / "set")
        writer.add("train", made("train", 0, model=Restless()))
    assert contents(tmp_path / "set") == before


@pytest.mark.parametrize("cut", [1, 20, 400])
def test_a_line_that_a_kill_left_incomplete_is_cut_off_and_its_state_made_again(tmp_path, cut):
    write(tmp_path / "first")
    with DatasetWriter(tmp_path / "second", plan()) as writer:
        for index in range(2):
            writer.add("train", made("train", index))
    lines = tmp_path / "second" / "train" / "states.jsonl"
    lines.write_bytes(lines.read_bytes()[:-cut])
    with DatasetWriter(tmp_path / "second", plan()) as writer:
        assert list(writer.settled("train")) == [0]
        for split in ("train", "test"):
            for index in range(3):
                writer.add(split, made(split, index))
        writer.finish()
    assert contents(tmp_path / "first") == contents(tmp_path / "second")


def test_chunks_that_a_kill_left_unfinished_are_removed(tmp_path):
    with DatasetWriter(tmp_path / "set", plan()) as writer:
        writer.add("train", made("train", 0))
    left = tmp_path / "set" / "train" / "outcomes" / "c" / "0.abc.partial"
    left.write_bytes(b"half")
    with DatasetWriter(tmp_path / "set", plan()):
        assert not left.exists()


def test_a_kill_at_any_point_of_the_end_is_made_good(tmp_path, monkeypatch):
    write(tmp_path / "first")
    steps = 0
    while True:
        path = tmp_path / f"stopped-{steps}"
        with DatasetWriter(path, plan()) as writer:
            for split in ("train", "test"):
                for index in range(3):
                    writer.add(split, made(split, index))
            ended = _finish_at_most(writer, steps, monkeypatch)
        with DatasetWriter(path, plan()) as writer:
            writer.finish()
        assert contents(path) == contents(tmp_path / "first")
        if ended:
            break
        steps += 1
    assert steps >= 4


class StoppedError(Exception):
    """Stands for the end of the process."""


def _finish_at_most(writer, steps, monkeypatch) -> bool:
    """Let the end change at most so many things, and return whether that was enough."""
    left = steps

    def counted(original):
        def change(*arguments, **options):
            nonlocal left
            if not left:
                raise StoppedError
            left -= 1
            return original(*arguments, **options)

        return change

    with monkeypatch.context() as patch:
        for owner, name in (("pathlib.Path", "replace"), ("pathlib.Path", "write_bytes"), ("zarr.Array", "resize")):
            module, attribute = owner.split(".")
            found = getattr(__import__(module), attribute)
            patch.setattr(found, name, counted(getattr(found, name)))
        try:
            writer.finish()
        except StoppedError:
            return False
    return True


def test_a_set_is_not_finished_without_all_its_states(tmp_path):
    with DatasetWriter(tmp_path / "set", plan()) as writer:
        writer.add("train", made("train", 0))
        with pytest.raises(RequestError, match="expected 5 settled samples in train, got 2: state 1 is missing"):
            writer.finish()
    with pytest.raises(RequestError, match="expected a complete data set"):
        Dataset.open(tmp_path / "set")


@pytest.mark.parametrize(
    ("changes", "name"), [({"seed": 4}, "seed"), ({"version": "2"}, "version"), ({"preset": "narrow"}, "preset")]
)
def test_a_set_of_another_plan_is_not_touched(tmp_path, changes, name):
    write(tmp_path / "set")
    before = contents(tmp_path / "set")
    with pytest.raises(RequestError, match=f"expected a data set with {name}"):
        DatasetWriter(tmp_path / "set", plan(**changes))
    assert contents(tmp_path / "set") == before


def test_a_folder_of_something_else_is_not_touched(tmp_path):
    (tmp_path / "thesis.txt").write_text("precious")
    with pytest.raises(RequestError, match="to be new, empty or a data set, got a folder of something else"):
        DatasetWriter(tmp_path, plan())
    assert [found.name for found in tmp_path.iterdir()] == ["thesis.txt"]


def test_lines_that_are_no_states_are_refused(tmp_path):
    write(tmp_path / "set")
    (tmp_path / "set" / "train" / "states.jsonl").write_text("{}\n")
    with pytest.raises(RequestError, match=r"states.jsonl: expected one state a line"):
        DatasetWriter(tmp_path / "set", plan())


def test_two_processes_do_not_write_to_one_set(tmp_path):
    with DatasetWriter(tmp_path / "set", plan()):
        context = multiprocessing.get_context("spawn")
        with context.Pool(1) as pool:
            message = pool.apply(_try_to_open, (tmp_path / "set",))
    assert "for this process alone, got another that writes to it" in message


def _try_to_open(path):
    try:
        DatasetWriter(path, plan())
    except UnavailableError as error:
        return str(error)
    return ""
