"""The journal of an optimisation, whatever happens to its file."""

import errno
import os
import resource
import signal
import subprocess
import sys
import time
from contextlib import suppress
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from common.domain.errors import CancelledError, ModelError, RequestError, TimedOutError, UnavailableError
from common.domain.model import Event
from common.domain.trial import Trial
from common.planning.evaluation import Evaluation
from common.storage import journal
from common.storage.journal import open_journal

NAME, OTHER = "a" * 64, "b" * 64
COURSE = {"models": ("heuristic", "simulator"), "estimators": ("heuristic",), "in_flight": 4}
HEIGHTS = np.random.default_rng(3).normal(0, 0.01, (7, 9)).astype(np.float32)
GOOD = Evaluation(
    trial=Trial(
        index=0,
        action=(0.1 + 0.2, -1 / 3),
        model="simulator",
        instance="a",
        version="3",
        reward=-np.pi * 1e-4,
        estimates={"heuristic": 0.1 / 3},
        warning="not_settled: 4 mm/s",
        started_s=0.1,
        predict_s=0.7,
        compute_s=0.6,
        uppers={"heuristic": 0.9},
        unfamiliar=("heuristic",),
    ),
    heights=HEIGHTS,
    split_s={"simulator": 0.6, "transport": 0.1},
    events=(Event("no_reply", "simulator/b", "it died", 0.2),),
)
FAILED = Evaluation(
    trial=Trial(1, (0.0, 0.01), "simulator", "", "", None, error="timed_out: too long"),
    heights=None,
    split_s={"transport": 30.0},
    events=(),
    failure=TimedOutError("too long"),
)


def numbered(index: int) -> Evaluation:
    return replace(GOOD, trial=replace(GOOD.trial, index=index))


def interrupted(folder: Path, *evaluations: Evaluation, name: str = NAME) -> Path:
    """Write a journal as a run that is interrupted leaves it, and return its path."""
    with suppress(CancelledError), open_journal(folder, name) as kept:
        kept.begin(**COURSE)
        for evaluation in evaluations:
            kept.append(evaluation)
        raise CancelledError
    return folder / f"{name}.jsonl"


def known(folder: Path, name: str = NAME) -> list[int]:
    """Return the indices of the evaluations that a journal holds, and leave it as it was."""
    with suppress(CancelledError), open_journal(folder, name) as kept:
        raise CancelledError
    return list(kept.evaluations)


def test_what_was_written_is_read_to_the_bit(tmp_path: Path):
    interrupted(tmp_path, GOOD, FAILED)
    with open_journal(tmp_path, NAME) as kept:
        assert kept.course is not None
        assert kept.course.model_dump(exclude={"format"}) == COURSE
        assert kept.begin(models=(), estimators=(), in_flight=1) == kept.course
        good, failed = kept.evaluations[0], kept.evaluations[1]
    assert (good.trial, good.split_s, good.events, good.failure) == (GOOD.trial, GOOD.split_s, GOOD.events, None)
    assert good.heights is not None
    assert good.heights.tobytes() == HEIGHTS.tobytes()
    assert failed.trial == FAILED.trial
    assert failed.heights is None
    assert isinstance(failed.failure, TimedOutError)
    assert str(failed.failure) == "too long"


def test_an_answered_optimisation_leaves_no_file(tmp_path: Path):
    with open_journal(tmp_path, NAME) as kept:
        kept.begin(**COURSE)
        kept.append(GOOD)
        assert len(list(tmp_path.iterdir())) == 1
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize(
    ("error", "is_kept"),
    [
        (CancelledError("gone"), True),
        (TimedOutError("late"), True),
        (UnavailableError("nobody"), True),
        (RequestError("wrong"), False),
        (ModelError("broken"), False),
        (ZeroDivisionError("a bug"), False),
    ],
)
def test_it_is_kept_where_the_same_request_may_find_more(tmp_path: Path, error: Exception, is_kept: bool):
    with suppress(type(error)), open_journal(tmp_path, NAME) as kept:
        kept.begin(**COURSE)
        kept.append(GOOD)
        raise error
    assert len(list(tmp_path.iterdir())) == is_kept


def test_without_one_reward_there_is_nothing_to_resume(tmp_path: Path):
    assert not interrupted(tmp_path, FAILED).exists()
    path = interrupted(tmp_path, FAILED, GOOD)
    lines = path.read_bytes().splitlines(keepends=True)
    path.write_bytes(b"".join(lines[:2]))
    with open_journal(tmp_path, NAME) as kept:
        assert kept.course is None
        assert kept.evaluations == {}


def test_another_request_finds_nothing(tmp_path: Path):
    interrupted(tmp_path, GOOD)
    assert known(tmp_path, OTHER) == []
    assert known(tmp_path) == [0]


def test_evaluations_may_come_in_any_order_and_the_last_of_an_index_counts(tmp_path: Path):
    newer = replace(numbered(2), trial=replace(numbered(2).trial, reward=-1.0))
    interrupted(tmp_path, numbered(2), numbered(0), newer)
    with open_journal(tmp_path, NAME) as kept:
        assert set(kept.evaluations) == {0, 2}
        assert kept.evaluations[2].trial.reward == -1.0


@pytest.mark.parametrize("cut", [1, 2, 50, -1])
def test_a_torn_last_line_is_dropped_and_written_over(tmp_path: Path, cut: int):
    path = interrupted(tmp_path, numbered(0), numbered(1), numbered(2))
    *whole, last = path.read_bytes().splitlines(keepends=True)
    path.write_bytes(b"".join(whole) + last[:cut])
    with suppress(CancelledError), open_journal(tmp_path, NAME) as kept:
        assert set(kept.evaluations) == {0, 1}
        kept.append(numbered(3))
        raise CancelledError
    assert known(tmp_path) == [0, 1, 3]


@pytest.mark.parametrize("rubbish", [b"\0" * 100 + b"\n", b"{}\n", b"\xff\xfe\n", b"[1, 2]\n", b'{"format": 2}\n'])
def test_what_comes_after_a_broken_line_is_not_trusted(tmp_path: Path, rubbish: bytes):
    path = interrupted(tmp_path, numbered(0), numbered(1), numbered(2))
    lines = path.read_bytes().splitlines(keepends=True)
    for place, expected in ((0, []), (1, []), (2, [0]), (3, [0, 1])):
        path.write_bytes(b"".join([*lines[:place], rubbish, *lines[place + 1 :]]))
        with open_journal(tmp_path, NAME) as kept:
            assert list(kept.evaluations) == expected
            assert (kept.course is None) == (not expected)


def test_a_resumed_run_that_is_interrupted_again_keeps_both_parts(tmp_path: Path):
    interrupted(tmp_path, numbered(0))
    interrupted(tmp_path, numbered(1))
    path = interrupted(tmp_path, numbered(2))
    assert known(tmp_path) == [0, 1, 2]
    assert len(path.read_text().splitlines()) == 4


def test_a_process_that_is_killed_leaves_what_it_had_appended_and_no_lock(tmp_path: Path):
    code = (
        "import os, sys, signal; from pathlib import Path\n"
        "sys.path[:0] = ['tests/unit/storage']\n"
        "from test_journal import COURSE, NAME, numbered, open_journal\n"
        f"kept = open_journal(Path({str(tmp_path)!r}), NAME)\n"
        "kept.begin(**COURSE)\n"
        "for index in range(5): kept.append(numbered(index))\n"
        "os.kill(os.getpid(), signal.SIGKILL)\n"
    )
    killed = subprocess.run([sys.executable, "-c", code], cwd=Path(__file__).parents[3], check=False, timeout=60)
    assert killed.returncode == -signal.SIGKILL
    assert known(tmp_path) == [0, 1, 2, 3, 4]


def test_the_same_optimisation_twice_at_a_time_is_kept_once(tmp_path: Path):
    with open_journal(tmp_path, NAME) as first:
        first.begin(**COURSE)
        first.append(numbered(0))
        with open_journal(tmp_path, NAME) as second:
            assert second.evaluations == {}
            second.begin(**COURSE)
            second.append(numbered(1))
        assert len((tmp_path / f"{NAME}.jsonl").read_text().splitlines()) == 2


def test_without_a_folder_nothing_is_kept():
    with open_journal(None, NAME) as kept:
        kept.begin(**COURSE)
        kept.append(GOOD)
        assert kept.evaluations == {}


def test_a_folder_that_cannot_be_is_said_and_costs_nothing_else(tmp_path: Path, caplog: pytest.LogCaptureFixture):
    (tmp_path / "file").touch()
    with open_journal(tmp_path / "file" / "journal", NAME) as kept:
        kept.begin(**COURSE)
        kept.append(GOOD)
    assert "expected a journal that can be written, this run is not kept" in caplog.text


def test_a_full_disk_ends_the_journal_and_not_the_optimisation(tmp_path: Path, caplog: pytest.LogCaptureFixture):
    before = resource.getrlimit(resource.RLIMIT_FSIZE)
    handler = signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
    try:
        with suppress(CancelledError), open_journal(tmp_path, NAME) as kept:
            kept.begin(**COURSE)
            kept.append(numbered(0))
            room = (tmp_path / f"{NAME}.jsonl").stat().st_size + 100
            resource.setrlimit(resource.RLIMIT_FSIZE, (room, before[1]))
            kept.append(numbered(1))
            kept.append(numbered(2))
            raise CancelledError
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, before)
        signal.signal(signal.SIGXFSZ, handler)
    assert known(tmp_path) == [0]
    assert caplog.text.count("from here on none is kept") == 1


def test_a_journal_does_not_grow_without_bound(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setattr(journal, "LARGEST_BYTES", 3000)
    path = interrupted(tmp_path, *(numbered(index) for index in range(20)))
    assert 1 <= len(known(tmp_path)) < 20
    assert path.stat().st_size <= 3000


def test_an_append_after_the_end_is_nothing(tmp_path: Path):
    with open_journal(tmp_path, NAME) as kept:
        kept.begin(**COURSE)
    kept.append(GOOD)
    assert list(tmp_path.iterdir()) == []


def abandoned(folder: Path, *, count: int, age_s: float = 0.0) -> list[Path]:
    """Leave journals that nobody came back for, the first the oldest."""
    paths = [interrupted(folder, GOOD, name=f"{number:064x}") for number in range(count)]
    for number, path in enumerate(paths):
        written = time.time() - age_s - count + number
        os.utime(path, (written, written))
    return paths


def test_journals_that_nobody_came_back_for_are_removed_in_time(tmp_path: Path):
    old = abandoned(tmp_path, count=2, age_s=journal.OLDEST_S)
    interrupted(tmp_path, GOOD)
    assert [path.exists() for path in old] == [False, False]


def test_of_too_many_journals_the_oldest_are_removed(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    paths = abandoned(tmp_path, count=6)
    monkeypatch.setattr(journal, "MOST_FILES", 4)
    interrupted(tmp_path, GOOD)
    assert [path.exists() for path in paths] == [False, False, False, True, True, True]
    monkeypatch.setattr(journal, "MOST_BYTES", int(2.5 * paths[-1].stat().st_size))
    assert known(tmp_path) == [0]
    assert [path.exists() for path in paths] == [False, False, False, False, True, True]


def test_other_files_and_journals_in_use_are_left_alone(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    (tmp_path / "notes.jsonl").write_text("mine")
    monkeypatch.setattr(journal, "OLDEST_S", -1.0)
    with open_journal(tmp_path, OTHER) as running:
        running.begin(**COURSE)
        interrupted(tmp_path, GOOD)
        assert (tmp_path / f"{OTHER}.jsonl").exists()
    assert (tmp_path / "notes.jsonl").read_text() == "mine"


def test_a_file_that_others_own_does_not_hinder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    (old,) = abandoned(tmp_path, count=1, age_s=journal.OLDEST_S)

    def refuse(path: Path) -> None:
        raise PermissionError(errno.EACCES, "not yours", str(path))

    with monkeypatch.context() as patch:
        patch.setattr(Path, "unlink", refuse)
        interrupted(tmp_path, GOOD)
    assert old.exists()
    assert known(tmp_path) == [0]
