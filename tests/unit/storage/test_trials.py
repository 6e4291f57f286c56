"""The record of trials: in order, once each, on disk before it is said, and readable by everything that reads cases."""

import os
import subprocess
import sys
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from datetime import UTC, datetime
from pathlib import Path

import numpy as np
import pytest

from common.domain.case import Case
from common.domain.errors import RequestError, UnavailableError
from common.domain.grid import Grid
from common.domain.scene import Item, Scene, State
from common.storage.cases import encode_case, read_cases, write_case
from common.storage.dataset_cases import samples_of_cases
from common.storage.trial_files import find_trials
from common.storage.trials import ExecutedTrial, TrialStore, trial_digest

NOW = datetime(2031, 5, 6, 7, 8, 9, tzinfo=UTC)


def a_trial(number: int = 0, *, robot: str = "arm-1", grid: Grid | None = None, **changes: object) -> ExecutedTrial:
    """Return a trial whose content and report's id follow from a number."""
    grid = grid or Grid(8, 8, 0.02)
    item, scene = np.zeros(grid.shape, dtype=np.float32), np.full(grid.shape, 1e-4 * number, dtype=np.float32)
    item[3:5, 3:5] = 0.01
    materials = np.zeros((3, *grid.shape), dtype=np.float32)
    materials[:, item > 0] = np.array([[1000.0], [1e5], [0.4]])
    state = State(Scene(grid, scene, np.zeros_like(materials)), Item(item, materials))
    case = Case("n", 0, state, scene + item, (0.01, -0.02), True, "fine", **changes)
    return ExecutedTrial(robot=robot, id=f"report-{number}", case=case, received=NOW)


@pytest.fixture
def store(tmp_path: Path) -> Iterator[TrialStore]:
    with TrialStore(tmp_path / "trials", task="plating") as opened:
        yield opened


def names(folder: Path) -> list[str]:
    return sorted(path.name for path in folder.iterdir())


def reopened(store: TrialStore, **options: object) -> TrialStore:
    store.close()
    return TrialStore(store.folder, task="plating", **options)


def test_trials_are_kept_in_the_order_of_recording_as_cases_and_as_samples(store: TrialStore):
    kept = [store.append(a_trial(number, robot=robot)) for number, robot in ((3, "b"), (1, "a"), (2, "b"))]
    assert [trial.number for trial in kept] == [1, 2, 3]
    assert names(store.folder) == [trial.file for trial in kept]
    assert kept[1].file == f"000002-a-{kept[1].digest[:12]}.npz"
    cases = read_cases(store.folder)
    assert [case.state.digest for case in cases] == [a_trial(number).case.state.digest for number in (3, 1, 2)]
    assert [case.reference_action for case in cases] == [(0.01, -0.02)] * 3
    np.testing.assert_array_equal(samples_of_cases(cases).outcomes[1], a_trial(1).case.target)


def test_a_record_tells_who_when_and_what(store: TrialStore):
    kept = store.append(a_trial(7, robot="arm-2"))
    (found,) = find_trials(store.folder).trials
    assert found == kept
    assert (found.robot, found.id, found.received, found.task) == ("arm-2", "report-7", NOW, "plating")
    assert found.digest == trial_digest(a_trial(7).case)
    assert found.item_volume == pytest.approx(4 * 0.01 * 4e-4)
    assert found.added_volume == pytest.approx(found.item_volume, rel=1e-4)
    assert not found.rigid


def test_the_same_content_reported_anew_is_a_duplicate_that_names_the_trial_that_has_it(store: TrialStore):
    store.append(a_trial(1))
    store.append(a_trial(2))
    again = a_trial(1)
    for other in (
        ExecutedTrial("arm-1", "another", again.case, NOW),
        ExecutedTrial("arm-2", again.id, again.case, NOW),
    ):
        with pytest.raises(RequestError, match="got a duplicate: trial 1, reported by arm-1 as report-1"):
            store.append(other)
    assert len(store) == len(names(store.folder)) == 2


def test_a_report_sent_again_gets_the_same_answer_also_after_a_restart(store: TrialStore):
    first = store.append(a_trial(1))
    store.append(a_trial(2))
    later = ExecutedTrial("arm-1", "report-1", a_trial(1).case, datetime.now(UTC))
    assert store.append(later) == first
    with reopened(store) as again:
        assert again.append(later) == first
        assert again.append(a_trial(3)).number == 3
        assert len(again) == 3


def test_a_report_s_id_with_other_content_is_refused(store: TrialStore):
    store.append(a_trial(1))
    with pytest.raises(RequestError, match="id: expected one that arm-1 has not used, got report-1: trial 1 has it"):
        store.append(ExecutedTrial("arm-1", "report-1", a_trial(2).case, NOW))
    store.append(ExecutedTrial("arm-2", "report-1", a_trial(2).case, NOW))


def test_only_one_grid_and_one_task_are_taken(store: TrialStore):
    other = Grid(8, 10, 0.02)
    with pytest.raises(RequestError, match="task: expected plating, got plating_yaw"):
        store.append(a_trial(1, task="plating_yaw"))
    store.append(a_trial(1))
    with pytest.raises(RequestError, match=r"grid: expected .*columns=8.* as the record has it, got .*columns=10"):
        store.append(a_trial(2, grid=other))
    with reopened(store) as again, pytest.raises(RequestError, match=r"grid: expected .*columns=8"):
        again.append(a_trial(2, grid=other))
    with pytest.raises(RequestError, match=r"expected trials on .*columns=10.*, got 000001-arm-1"):
        TrialStore(store.folder, task="plating", grid=other)
    with pytest.raises(RequestError, match=r"expected trials of plating_yaw, got 000001-arm-1.* of plating"):
        TrialStore(store.folder, task="plating_yaw")
    assert len(names(store.folder)) == 1


def test_a_grid_that_was_asked_for_is_the_only_one(tmp_path: Path):
    with TrialStore(tmp_path, task="plating", grid=Grid(8, 10, 0.02)) as store:
        with pytest.raises(RequestError, match="grid: expected"):
            store.append(a_trial(1))
        assert store.append(a_trial(1, grid=Grid(8, 10, 0.02))).number == 1


def _cut(path: Path) -> None:
    path.write_bytes(path.read_bytes()[:-40])


def _renamed(path: Path) -> None:
    path.rename(path.with_name(path.name.replace("arm-1", "arm-9")))


def _plain(path: Path) -> None:
    write_case(path, a_trial(2).case)


def _without_a_grid(path: Path) -> None:
    entry = find_trials(path.parent).trials[1].entry() | {"rows": 0}
    path.write_bytes(encode_case(a_trial(2).case, trial=entry))


@pytest.mark.parametrize("damage", [_cut, _renamed, _plain, _without_a_grid])
def test_a_broken_file_is_reported_left_out_and_never_deleted(store: TrialStore, damage, caplog):
    first, second, _ = (store.append(a_trial(number)) for number in (1, 2, 3))
    damage(store.folder / second.file)
    there = names(store.folder)
    with reopened(store) as again:
        (told,) = [record.getMessage() for record in caplog.records]
        assert told.startswith("left out of the record: ")
        assert str(store.folder) in told
        assert "000002-arm-" in told
        assert len(again) == 2
        assert again.append(a_trial(1)) == first
        assert again.append(a_trial(2)).number == 4
    assert names(store.folder)[:-1] == there


def test_the_number_of_a_broken_last_trial_is_not_given_again(store: TrialStore):
    for number in (1, 2):
        last = store.append(a_trial(number))
    _cut(store.folder / last.file)
    with reopened(store) as again:
        assert again.append(a_trial(3)).number == 3


def test_leftovers_of_unfinished_writes_are_removed_and_other_files_stay(store: TrialStore):
    kept = store.append(a_trial(1))
    (store.folder / f".{kept.file}.partial").write_bytes(b"half a trial")
    (store.folder / "notes.txt").write_text("mine")
    with reopened(store):
        assert names(store.folder) == [kept.file, "notes.txt"]


def test_a_folder_is_one_process_s_alone_until_that_ends(store: TrialStore):
    code = "import pathlib\nfrom common.storage.trials import TrialStore\n"
    code += f"TrialStore(pathlib.Path({str(store.folder)!r}), task='plating')"
    other = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False, timeout=60)
    assert "UnavailableError: expected" in other.stderr
    assert "for this recorder alone, got another process that writes to it" in other.stderr
    with pytest.raises(UnavailableError):
        TrialStore(store.folder, task="plating")
    with reopened(store) as again:
        assert again.append(a_trial(1)).number == 1


def test_file_and_folder_are_on_disk_before_the_answer(store: TrialStore, monkeypatch: pytest.MonkeyPatch):
    synced: list[str] = []

    def note(descriptor: int) -> None:
        path = Path(os.readlink(f"/proc/self/fd/{descriptor}"))
        synced.append(f"{path.name} {len(list(store.folder.glob('[!.]*.npz')))}")

    monkeypatch.setattr(os, "fsync", note)
    kept = store.append(a_trial(1))
    assert synced == [f".{kept.file}.partial 0", "trials 1"]


def test_a_disk_that_refuses_a_trial_leaves_nothing_and_the_report_can_come_again(
    store: TrialStore, monkeypatch: pytest.MonkeyPatch
):
    def refuse(descriptor: int) -> None:
        raise OSError(28, "No space left on device")

    with monkeypatch.context() as full:
        full.setattr(os, "fsync", refuse)
        with pytest.raises(UnavailableError, match=r"expected room on a disk .*No space left"):
            store.append(a_trial(1))
    assert names(store.folder) == []
    assert store.append(a_trial(1)).number == 1


def test_a_trial_whose_folder_could_not_be_synced_is_answered_only_once_it_is(
    store: TrialStore, monkeypatch: pytest.MonkeyPatch
):
    synced: list[int] = []

    def refuse_the_second(descriptor: int) -> None:
        synced.append(descriptor)
        if len(synced) in (2, 3):
            raise OSError(5, "Input/output error")

    monkeypatch.setattr(os, "fsync", refuse_the_second)
    for _ in range(2):
        with pytest.raises(UnavailableError, match="Input/output error"):
            store.append(a_trial(1))
    assert store.append(a_trial(1)).number == 1
    assert len(names(store.folder)) == 1


def test_a_folder_that_cannot_be_made_is_unavailable(tmp_path: Path):
    (tmp_path / "file").write_text("no folder")
    with pytest.raises(UnavailableError, match="expected a folder for trials in"):
        TrialStore(tmp_path / "file" / "trials", task="plating")


def test_several_threads_record_each_trial_once(store: TrialStore):
    with ThreadPoolExecutor(4) as pool:
        kept = list(pool.map(lambda number: store.append(a_trial(number % 20)), range(60)))
    assert {trial.number for trial in kept} == set(range(1, 21))
    assert len(names(store.folder)) == 20


def test_a_folder_that_is_not_there_has_no_trials_to_find(tmp_path: Path):
    with pytest.raises(RequestError, match=r"expected a folder of trials, got .*none, which does not exist"):
        find_trials(tmp_path / "none")
