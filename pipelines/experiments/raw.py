"""Raw results: JSON Lines with a first line that says what they rest on; whatever is there is not made again."""

import json
from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from common.domain.errors import RequestError
from pipelines.data.local import local_processes
from pipelines.experiments.place import Report
from pipelines.json_lines import read_json_lines

Row = dict[str, Any]
FILE = "raw.jsonl"


@dataclass(frozen=True)
class Raw:
    """What a file of raw results holds.

    Attributes:
        header: What the rows rest on: kind, parameters, versions, weights, seeds, and the number of ``rows``.
        rows: One for each job and what it yields.
    """

    header: Mapping[str, Any]
    rows: Sequence[Row]

    @property
    def is_complete(self) -> bool:
        """Whether every job has been done."""
        return len(self.rows) == self.header["rows"]


def read_raw(path: Path) -> Raw:
    """Read raw results; a last line that an interruption broke is left out.

    Raises:
        RequestError: It is no such file.
    """
    lines = read_json_lines(path)
    if not lines or "measurement" not in lines[0]:
        raise RequestError(f"{path}: expected a measurement in the first line, got {lines[:1]!r:.80}")
    return Raw(lines[0]["measurement"], lines[1:])


def collect(
    path: Path,
    about: Mapping[str, Any],
    jobs: Mapping[str, int],
    work: Callable[[str], Sequence[Row]],
    *,
    workers: int = 1,
    report: Report = lambda done, total: None,
) -> None:
    """Do the jobs that are not done, and append what each yields as soon as those before it are done.

    Args:
        path: The file.
        about: What the rows rest on.
        jobs: Number of rows that each job yields, by its name.
        work: Does a job; with several workers it is called in processes of their own, and has to be pickled.
        workers: Jobs at the same time.
        report: Told of progress.

    Raises:
        RequestError: The file rests on something else.
    """
    header = json.loads(json.dumps({**about, "rows": sum(jobs.values())}))
    done = _resume(path, header, jobs)
    todo = [job for job in jobs if job not in done]
    report(len(done), len(jobs))
    with path.open("a") as file:

        def keep(job: str, rows: Sequence[Row]) -> None:
            if len(rows) != jobs[job]:
                raise RuntimeError(f"{job}: expected {jobs[job]} rows, got {len(rows)}")
            file.write("".join(json.dumps({"job": job, **row}) + "\n" for row in rows))
            file.flush()
            done.add(job)
            report(len(done), len(jobs))

        if workers == 1 or len(todo) < 2:
            for job in todo:
                keep(job, work(job))
            return
        with local_processes(workers) as pool:
            futures = {job: pool.submit(work, job) for job in todo}
            for job, future in futures.items():
                keep(job, future.result())


def _resume(path: Path, header: Mapping[str, Any], jobs: Mapping[str, int]) -> set[str]:
    """Return the jobs that are done; rows of one that was interrupted are dropped."""
    path.parent.mkdir(parents=True, exist_ok=True)
    rows: Sequence[Row] = ()
    if path.exists() and path.stat().st_size:
        found = read_raw(path)
        different = sorted(
            name for name in {*found.header, *header} if found.header.get(name) != header.get(name)
        )  # fmt: skip
        if different:
            raise RequestError(
                f"{path}: expected raw results of the same {', '.join(different)}, got others; remove "
                f"{path.parent} to measure again"
            )
        rows = found.rows
    counts = Counter(row["job"] for row in rows)
    done = {job for job, count in counts.items() if count == jobs[job]}
    unfinished = path.with_name(f".{path.name}.partial")
    kept = [row for row in rows if row["job"] in done]
    unfinished.write_text("".join(json.dumps(line) + "\n" for line in ({"measurement": header}, *kept)))
    unfinished.replace(path)
    return done
