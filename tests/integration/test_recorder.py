"""A recorder in a process of its own: what robots report is kept once, and before it is acknowledged."""

import time
from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np
import pytest
import zenoh

from common.domain.errors import RequestError
from common.storage.cases import read_cases
from common.storage.trial_files import find_trials
from common.wire.array import Array
from common.wire.client import list_workers, report_trial
from common.wire.codec import decode, encode
from common.wire.keys import trial_key
from common.wire.messages import ErrorReply, Health
from common.wire.query import NoReplyError, ask
from common.wire.report import TrialReply, TrialReport
from common.wire.session import Session
from common.wire.state import GridMessage
from tests.fakes import serving
from tests.recorder_fakes import ADDRESS, a_report, wait_for_recorder


def outcome(change: Callable[[np.ndarray], np.ndarray]) -> dict[str, object]:
    return {"outcome": Array.of(change(np.array(a_report(0).outcome.values())))}


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("recorder") / "trials"


@pytest.fixture(scope="module")
def log(endpoint: str, session: Session, folder: Path) -> Iterator[Path]:
    """The log of a recorder that runs as long as the module's tests, with one trial from the start."""
    log = folder.with_name("log")
    options = ("--task", "plating", "--folder", str(folder), "--instance", "r")
    with serving("recorder", *options, endpoint=endpoint, log=log):
        wait_for_recorder(session, log)
        assert report_trial(session, a_report(0), task="plating", robot="first").number == 1
        yield log


def health(session: Session) -> Health:
    """Return how the recorder is; a connection that a busy machine has just lost comes back."""
    deadline = time.monotonic() + 20
    while True:
        try:
            return ask(session, ADDRESS.key("health"), None, Health, timeout_s=20)
        except NoReplyError:
            if time.monotonic() > deadline:
                raise
            time.sleep(0.2)


def wait_until(is_so: Callable[[], bool], log: Path) -> None:
    deadline = time.monotonic() + 20
    while not is_so():
        assert time.monotonic() < deadline, log.read_text()
        time.sleep(0.02)


def test_a_report_is_kept_with_its_robot_and_acknowledged_alike_when_it_comes_again(
    session: Session, folder: Path, log: Path
):
    report = a_report(1)
    first = report_trial(session, report, task="plating", robot="arm-1")
    assert report_trial(session, report, task="plating", robot="arm-1") == first
    (kept,) = [trial for trial in find_trials(folder).trials if trial.number == first.number]
    assert (kept.file, kept.digest, kept.id, kept.robot) == (first.file, first.digest, "trial-1", "arm-1")
    cases = {case.name: case for case in read_cases(folder)}
    case = cases["arm-1-trial-1"]
    assert case.reference_action == report.action
    assert case.notes == report.notes
    np.testing.assert_array_equal(case.target, report.outcome.values())


def test_the_recorder_s_own_key_needs_the_robot_s_name_in_the_report(session: Session, log: Path):
    own = ADDRESS.key("trial")
    with pytest.raises(RequestError, match="robot: expected a name in the report or in the key, trial/<robot>"):
        ask(session, own, a_report(2), TrialReply, timeout_s=20)
    assert ask(session, own, a_report(2, robot="arm-2"), TrialReply, timeout_s=20).robot == "arm-2"


OTHER_GRID = a_report(0).state.model_copy(update={"grid": GridMessage(rows=16, columns=16, cell=0.011)})
REFUSED: dict[str, tuple[str, TrialReport, str]] = {
    "another robot": ("arm-1", a_report(3, robot="arm-2"), "robot: expected arm-1 as the key names it, got arm-2"),
    "no name": ("-arm", a_report(3), "robot: expected 1 to 64 letters"),
    "wrong shape": ("arm-1", a_report(3, **outcome(lambda h: h[:8])), "outcome: expected shape (16, 16), got (8, 16)"),
    "NaN": ("arm-1", a_report(3, **outcome(lambda h: h * np.nan)), "outcome: expected finite numbers, got 256"),
    "infinite": ("arm-1", a_report(3, **outcome(lambda h: h + np.inf)), "outcome: expected finite numbers, got 256"),
    "millimetres": ("arm-1", a_report(3, **outcome(lambda h: 1e3 * h)), "outcome: expected heights of at most 1 m"),
    "decimetres": ("arm-1", a_report(3, **outcome(lambda h: 20 * h)), "outcome: expected heights within 0.5 m"),
    "another grid": ("arm-1", a_report(3, state=OTHER_GRID), "as the record has it, got Grid(rows=16, columns=16"),
    "off the plate": ("arm-1", a_report(3, action=(0.07, 0.0)), "action: expected x between -0.06 and 0.06 m, got 0.0"),
    "another action": ("arm-1", a_report(3, action=(0.0, 0.0, 1.0)), "action: expected x, y as plating has it, got 3"),
    "nothing placed": (
        "arm-1",
        a_report(3, outcome=a_report(3).state.scene.heights),
        "outcome: expected a mean difference to the scene of at least 5 um, got 0 um",
    ),
    "too much": ("arm-1", a_report(3, **outcome(lambda h: h + 0.02)), "times the item's volume above the scene, got"),
    "a duplicate": ("arm-1", a_report(0), "got a duplicate: trial 1, reported by first as trial-0"),
    "an id that is used": ("first", a_report(3, id="trial-0"), "id: expected one that first has not used, got trial-0"),
}


@pytest.mark.parametrize("kind", REFUSED)
def test_what_cannot_be_true_is_refused_with_a_reason_and_not_kept(
    session: Session, folder: Path, log: Path, kind: str
):
    robot, report, reason = REFUSED[kind]
    before = len(list(folder.iterdir()))
    (reply,) = session.get(f"frugal/@v1/plating/trial/{robot}", payload=encode(report)[0], timeout=20)
    assert reply.err is not None, reply.ok
    error = decode(reply.err.payload.to_bytes(), str(reply.err.encoding), ErrorReply)
    assert error.code == "request"
    assert reason in error.message
    assert len(list(folder.iterdir())) == before


@pytest.mark.parametrize(
    ("payload", "reason"),
    [
        (b"", "expected TrialReport as the payload, got none"),
        (b"\xc1 garbage", "expected TrialReport as MessagePack"),
        (b'{"action": [0, 0]}', "TrialReport: state: Field required"),
        (b'{"state": 3, "action": [NaN, 0], "outcome": 1}', "expected TrialReport as JSON"),
    ],
)
def test_what_is_no_report_is_refused(session: Session, log: Path, payload: bytes, reason: str):
    (reply,) = session.get(trial_key("plating", "arm-1"), payload=payload, timeout=20)
    assert reply.err is not None
    assert reason in reply.err.payload.to_bytes().decode(errors="replace")


def test_a_task_that_nobody_records_is_answered_with_the_known_one(session: Session, log: Path):
    with pytest.raises(RequestError, match="task: expected plating, got frugal/@v1/cooking/trial/arm-1"):
        report_trial(session, a_report(3), task="cooking", robot="arm-1")


def test_what_is_put_is_kept_or_refused_in_the_log_and_counted(session: Session, folder: Path, log: Path):
    before = health(session)
    payload, encoding = encode(a_report(5))
    session.put(trial_key("plating", "quiet"), payload, encoding=encoding)
    wait_until(lambda: health(session).served == before.served + 1, log)
    assert [trial.id for trial in find_trials(folder).trials if trial.robot == "quiet"] == ["trial-5"]
    session.put(trial_key("plating", "quiet"), encode(a_report(6, action=(9.0, 0.0)))[0])
    session.put(trial_key("plating", "quiet"), b"garbage")
    wait_until(lambda: health(session).refused == before.refused + 2, log)
    text = log.read_text()
    assert "trial/quiet: refused what was put" in text
    assert "action: expected x between -0.06 and 0.06 m, got 9" in text
    assert "expected TrialReport as MessagePack" in text


def test_a_question_to_all_workers_is_no_report(session: Session, log: Path):
    before = health(session)
    for task in ("plating", "cooking", "*"):
        list_workers(session, task=task)
        replies = session.get(f"frugal/@v1/{task}/trial/*", payload=b"{}", target=zenoh.QueryTarget.ALL, timeout=20)
        assert list(replies) == []
    assert health(session).refused == before.refused


def test_a_second_recorder_of_the_folder_ends_with_one_line(endpoint: str, folder: Path, log: Path, tmp_path: Path):
    with serving("recorder", "--folder", str(folder), endpoint=endpoint, log=tmp_path / "log") as second:
        assert second.wait(60) == 1
    told = (tmp_path / "log").read_text().splitlines()
    assert told == [
        f"frugal: unavailable: expected {folder} for this recorder alone, got another process that writes to it"
    ]
