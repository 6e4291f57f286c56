"""A recorder that is killed in the middle: every acknowledged trial is there afterwards, and none twice."""

import threading
import time
from concurrent.futures import ThreadPoolExecutor
from contextlib import ExitStack
from pathlib import Path

import pytest

from common.domain.errors import FrugalError, RequestError, UnavailableError
from common.storage.cases import read_cases
from common.storage.trial_files import find_trials
from common.wire.client import report_trial
from common.wire.report import TrialReply
from common.wire.session import Session
from tests.fakes import serving
from tests.recorder_fakes import START_S, a_report, wait_for_recorder


def test_without_a_recorder_a_report_is_unavailable(session: Session):
    with pytest.raises(UnavailableError, match="expected a recorder behind frugal/@v1/plating/trial/arm-1"):
        report_trial(session, a_report(3), task="plating", robot="arm-1")


@pytest.mark.timeout(180)
def test_a_recorder_that_is_killed_loses_and_doubles_nothing_that_it_acknowledged(
    endpoint: str, session: Session, tmp_path: Path
):
    folder, log = tmp_path / "trials", tmp_path / "log"
    options = (
        "recorder",
        "--task",
        "plating",
        "--folder",
        str(folder),
        "--grid",
        "16",
        "16",
        "0.01",
        "--instance",
        "r",
    )
    acknowledged: dict[int, TrialReply] = {}
    half = threading.Event()

    def report(number: int) -> None:
        deadline = time.monotonic() + START_S
        while number not in acknowledged:
            try:
                reply = report_trial(session, a_report(number), task="plating", robot=f"arm-{number % 5}", timeout_s=10)
                acknowledged[number] = reply
            except RequestError:
                raise
            except FrugalError:
                assert time.monotonic() < deadline, log.read_text()
                time.sleep(0.05)
        if len(acknowledged) >= 200:
            half.set()

    with ThreadPoolExecutor(8) as pool, ExitStack() as stack:
        first = stack.enter_context(serving(*options, endpoint=endpoint, log=log))
        wait_for_recorder(session, log)
        reports = [pool.submit(report, number) for number in range(500)]
        assert half.wait(START_S), log.read_text()
        first.kill()
        first.wait()
        assert len(acknowledged) < 500
        stack.enter_context(serving(*options, endpoint=endpoint, log=log))
        for done in reports:
            done.result(START_S)
    found = find_trials(folder)
    assert found.broken == ()
    assert [trial.number for trial in found.trials] == list(range(1, 501))
    kept = {trial.id: trial for trial in found.trials}
    assert len(kept) == len(acknowledged) == 500
    for number, reply in acknowledged.items():
        trial = kept[f"trial-{number}"]
        assert (trial.number, trial.digest, trial.file) == (reply.number, reply.digest, reply.file)
    names = [case.name for case in read_cases(folder)]
    assert names == [f"{trial.robot}-{trial.id}" for trial in found.trials]
    assert {path.suffix for path in folder.iterdir()} == {".npz"}
