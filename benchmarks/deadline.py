"""Measure by how much answers come later than their deadline, in this process and from a running system.

Run ``python -m benchmarks.deadline [--local] [--json]`` from the root of the checkout; it takes about two minutes. The
wire's overrun is measured at the client: it holds the request's and the answer's way, and the codec. On a machine with
other work a thread that only waits wakes up late too; by how much is measured beside it.
"""

import argparse
import json
import tempfile
import threading
import time
from collections.abc import Callable
from contextlib import ExitStack
from pathlib import Path

from benchmarks.system import bundled, start
from common.domain.case import Case
from common.domain.errors import TimedOutError
from common.domain.trial import Result
from common.planning.optimize import optimize
from common.planning.problem import Problem
from common.tasks import TASKS
from common.wire import client
from services.cli.optimize import make_request
from services.heuristic import HeuristicModel
from services.simulator.model import SimulatorModel

DEADLINES = (0.3, 1.0, 3.0)
RUNS = 5
OPTIONS = {
    "quality": {"strategy": "quality", "in_flight": 2},
    "transport:calls=4000": {"strategy": "transport:calls=4000", "evaluations": 4000, "in_flight": 2},
    "only:simulator": {"strategy": "only:simulator", "evaluations": 4000, "in_flight": 2},
}
"""The second and third never end by themselves."""


def main() -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--json", action="store_true", help="print JSON only")
    parser.add_argument("--local", action="store_true", help="leave the running system out")
    options = parser.parse_args()
    cases = [*bundled().values()][:RUNS]
    simulator = SimulatorModel()
    simulator.warm()
    models = {model.name: model for model in (HeuristicModel(), simulator)}

    def locally(case: Case, deadline_s: float, fields: dict[str, object]) -> Result:
        return optimize(Problem(TASKS["plating"], case.state, case.target), models, {}, deadline_s=deadline_s, **fields)

    rows = measure("local", cases, locally)
    if not options.local:
        with ExitStack() as stack:
            folder = Path(stack.enter_context(tempfile.TemporaryDirectory()))
            session = start(stack, simulators=2, log_folder=folder)

            def remotely(case: Case, deadline_s: float, fields: dict[str, object]) -> Result:
                return client.optimize(session, make_request(case, deadline_s=deadline_s, **fields)).result()

            remotely(cases[0], 1.0, OPTIONS["quality"])
            rows += measure("wire", cases, remotely)
    if options.json:
        print(json.dumps(rows))
        return
    for row in rows:
        late = ", ".join("early" if ms is None else f"{ms:.0f}" for ms in row["overruns_ms"])
        bare = ", ".join(f"{ms:.0f}" for ms in row["bare_ms"])
        print(f"{row['where']:5s} {row['strategy']:20s} {row['deadline_s']:.1f} s: late by {late} ms; {row['answers']}")
        print(f"      a thread that only waits, just before: {bare} ms")


def measure(
    where: str, cases: list[Case], run: Callable[[Case, float, dict[str, object]], Result]
) -> list[dict[str, object]]:
    """Return a row per strategy and deadline: overruns [ms], None where the search had ended before."""
    rows: list[dict[str, object]] = []
    for name, fields in OPTIONS.items():
        for deadline_s in DEADLINES:
            overruns: list[float | None] = []
            answers: list[str] = []
            bare: list[float] = []
            for case in cases:
                began = time.perf_counter()
                threading.Event().wait(0.3)
                bare.append(1e3 * (time.perf_counter() - began - 0.3))
                began = time.perf_counter()
                try:
                    result = run(case, deadline_s, fields)
                    answer = next(trial.model for trial in result.trials if trial.reward == result.reward)
                except TimedOutError:
                    answer = "none known"
                late_s = time.perf_counter() - began - deadline_s
                overruns.append(1e3 * late_s if late_s > 0 else None)
                answers.append(answer)
                time.sleep(0.5)  # what was abandoned ends
            rows.append(
                {"where": where, "strategy": name, "deadline_s": deadline_s, "overruns_ms": overruns, "bare_ms": bare}
                | {"answers": {model: answers.count(model) for model in sorted(set(answers))}}
            )
    return rows


if __name__ == "__main__":
    main()
