"""Raw results are kept as they come, and nothing is made twice."""

import json
from pathlib import Path
from typing import Any

import pytest

from common.domain.errors import ModelError, RequestError
from pipelines.experiments.raw import collect, read_raw

JOBS = {"a": 1, "b": 2, "c": 1}
ABOUT = {"kind": "counting", "parameters": {"step": 1}, "seeds": [0]}


class Work:
    """Counts what it is asked for; fails at one job."""

    def __init__(self, *, fails_at: str = "") -> None:
        self.asked: list[str] = []
        self.fails_at = fails_at

    def __call__(self, job: str) -> list[dict[str, Any]]:
        self.asked.append(job)
        if job == self.fails_at:
            raise ModelError("the solver diverged")
        return [{"value": f"{job}{place}"} for place in range(JOBS[job])]


def test_rows_follow_a_line_about_what_they_rest_on(tmp_path: Path):
    told: list[tuple[int, int]] = []
    collect(tmp_path / "raw.jsonl", ABOUT, JOBS, Work(), report=lambda *done: told.append(done))
    found = read_raw(tmp_path / "raw.jsonl")
    assert found.header == {**ABOUT, "rows": 4}
    assert [(row["job"], row["value"]) for row in found.rows] == [("a", "a0"), ("b", "b0"), ("b", "b1"), ("c", "c0")]
    assert found.is_complete
    assert told == [(0, 3), (1, 3), (2, 3), (3, 3)]


def test_an_interrupted_run_goes_on_where_it_stopped(tmp_path: Path):
    path, work = tmp_path / "raw.jsonl", Work()
    with pytest.raises(ModelError):
        collect(path, ABOUT, JOBS, Work(fails_at="c"))
    assert not read_raw(path).is_complete
    collect(path, ABOUT, JOBS, work)
    assert work.asked == ["c"]
    assert read_raw(path).is_complete


@pytest.mark.parametrize("kept", [3, 2], ids=["a job without its second row", "a job without its rows"])
def test_a_job_that_was_broken_by_an_interruption_is_done_again(tmp_path: Path, kept: int):
    path, work = tmp_path / "raw.jsonl", Work()
    collect(path, ABOUT, JOBS, Work())
    whole = path.read_text()
    path.write_text("".join(whole.splitlines(keepends=True)[:kept]) + '{"job": "b", "val')
    collect(path, ABOUT, JOBS, work)
    assert work.asked == ["b", "c"]
    assert path.read_text() == whole


def test_a_finished_run_is_not_run_again(tmp_path: Path):
    work = Work()
    collect(tmp_path / "raw.jsonl", ABOUT, JOBS, Work())
    collect(tmp_path / "raw.jsonl", ABOUT, JOBS, work)
    assert work.asked == []


def test_raw_results_of_other_weights_are_not_gone_on_with(tmp_path: Path):
    path = tmp_path / "raw.jsonl"
    collect(path, {**ABOUT, "weights": {"learned": ["1", "ab"]}}, JOBS, Work())
    before = path.read_text()
    with pytest.raises(RequestError, match="expected raw results of the same weights, got others; remove"):
        collect(path, {**ABOUT, "weights": {"learned": ["1", "cd"]}}, JOBS, Work())
    assert path.read_text() == before


def test_a_file_that_holds_something_else_is_refused(tmp_path: Path):
    path = tmp_path / "raw.jsonl"
    path.write_text(json.dumps({"experiment": {}}) + "\n")
    with pytest.raises(RequestError, match="expected a measurement in the first line"):
        read_raw(path)
    path.write_text('{"measurement": {}}\nnonsense\n{}\n')
    with pytest.raises(RequestError, match="expected JSON in line 2"):
        read_raw(path)
