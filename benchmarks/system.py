"""Measure the whole system on this machine, in one run: accuracy on the bundled scenes, speed-up, overhead.

Run ``python -m benchmarks.system [--json]`` from the root of the checkout. It starts router, heuristic, two simulators
and orchestrator as `frugal up` does, and a second system with one simulator beside it for the speed-up.
"""

import argparse
import json
import os
import socket
import tempfile
from collections import Counter
from contextlib import ExitStack
from itertools import pairwise
from pathlib import Path
from statistics import mean, median

from common.domain.case import Case
from common.domain.trial import Result
from common.storage.cases import read_cases
from common.storage.results import action_error
from common.wire import client
from common.wire.session import Session, open_session
from common.wire.settings import WireSettings
from services.cli.asking import EXAMPLES
from services.cli.optimize import make_request
from services.cli.processes import Crew
from services.cli.up import start_system, wait_until_ready
from services.simulator.model import SimulatorModel

EVALUATIONS = 50
SPEED_UP_SCENES = ("01-steak-heap", "05-irregular-heaps", "06-rigid-rim")


def main() -> None:
    """Run everything and print it."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--json", action="store_true", help="print JSON only")
    as_json = parser.parse_args().json
    SimulatorModel().warm()
    cases = bundled()
    with ExitStack() as stack:
        folder = Path(stack.enter_context(tempfile.TemporaryDirectory()))
        two = start(stack, simulators=2, log_folder=folder / "two")
        one = start(stack, simulators=1, log_folder=folder / "one")
        found = {
            "accuracy": accuracy(two, cases),
            "speed_up": speed_up(one, two, [cases[name] for name in SPEED_UP_SCENES]),
            "overhead": overhead(two, next(iter(cases.values()))),
        }
    print(json.dumps(found, indent=None if as_json else 2))


def bundled() -> dict[str, Case]:
    """Return the bundled scenes of plating by name."""
    return {case.name: case for case in read_cases(EXAMPLES / "scenes")}


def start(stack: ExitStack, *, simulators: int, log_folder: Path) -> Session:
    """Start a system of its own router and return a session with it."""
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        endpoint = f"tcp/127.0.0.1:{probe.getsockname()[1]}"
    settings = WireSettings(connect=(endpoint,), listen=(endpoint,))
    environment = os.environ | {"FRUGAL_CONNECT": endpoint, "FRUGAL_LISTEN": endpoint}
    crew = stack.enter_context(Crew(environment=environment, log_folder=log_folder))
    expected: Counter[str] = start_system(crew, simulators=simulators)
    wait_until_ready(crew, settings, expected, stopped=lambda: False)
    return stack.enter_context(open_session(settings))


def run(session: Session, case: Case, **options: object) -> Result:
    """Optimise one case."""
    return client.optimize(session, make_request(case, evaluations=EVALUATIONS, **options)).result()


def accuracy(session: Session, cases: dict[str, Case]) -> dict[str, object]:
    """Return the action error of the simulator alone on the scenes whose target was made with the same item [m]."""
    results = {
        name: run(session, case, strategy="only:simulator", in_flight=4)
        for name, case in cases.items()
        if case.reference_action is not None
    }
    errors = {name: action_error(result, cases[name]) or 0.0 for name, result in results.items()}
    return {
        "evaluations": EVALUATIONS,
        "error_m": errors,
        "median_m": median(errors.values()),
        "mean_m": mean(errors.values()),
        "wall_s": {name: result.wall_s for name, result in results.items()},
        "not_settled": sum(bool(trial.warning) for result in results.values() for trial in result.trials),
    }


def speed_up(one: Session, two: Session, cases: list[Case]) -> dict[str, object]:
    """Return how much faster two simulators are than one with four evaluations in flight, scene by scene in turn."""
    options = {"strategy": "only:simulator", "in_flight": 4}
    pairs = [(run(one, case, **options), run(two, case, **options)) for case in cases]
    ratios = [alone.wall_s / together.wall_s for alone, together in pairs]
    same = all([t.action for t in a.trials] == [t.action for t in b.trials] for a, b in pairs)
    return {"ratios": ratios, "median": median(ratios), "same_trials": same}


def overhead(session: Session, case: Case) -> dict[str, object]:
    """Return what an evaluation takes besides the model, at 40 to 50 points, over real transport [s]."""
    times: list[float] = []
    for seed in range(3):
        trials = run(session, case, strategy="only:heuristic", in_flight=1, seed=seed).trials
        for trial, following in pairwise(trials[40:]):
            times.append(following.started_s - trial.started_s - trial.compute_s)
    return {"median_s": median(times), "largest_s": max(times), "count": len(times)}


if __name__ == "__main__":
    main()
