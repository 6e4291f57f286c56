"""The orchestrator is killed in mid-run and restarted, as `frugal up` and Compose do: nothing is paid for twice."""

import json
import os
import signal
import subprocess
import sys
import threading
import time
from collections import Counter
from collections.abc import Callable, Iterator
from contextlib import ExitStack
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pytest

from common.domain.case import Case
from common.domain.errors import UnavailableError
from common.domain.trial import Result
from common.planning.optimize import optimize
from common.planning.problem import Problem
from common.storage.cases import write_case
from common.tasks import TASKS
from common.wire import client
from common.wire.optimization import Progress
from common.wire.session import Session, open_session
from common.wire.settings import WireSettings
from services.cli.optimize import make_request
from services.cli.processes import Crew
from services.heuristic import HeuristicModel
from tests.fakes import free_endpoint, make_state
from tests.served_models import CountedSimulator

ROOT = Path(__file__).parents[2]
STATE = make_state(3)
TARGET = CountedSimulator.predicted(STATE, np.array([[0.0123, -0.0057]]))[0]
CASE = Case("resume", 3, STATE, TARGET, (0.0123, -0.0057), True)
WORKERS = {"heuristic/h", "simulator/a", "simulator/b", "orchestrator/o"}
INTERRUPTIBLE = """
import signal
from services.cli.main import main
signal.signal(signal.SIGINT, signal.default_int_handler)  # a shell's background jobs ignore it
main()
"""
Action = tuple[float, ...]


@dataclass(frozen=True)
class System:
    """The processes of one system, and where its orchestrator and its simulators write."""

    crew: Crew
    session: Session
    environment: dict[str, str]
    journal: Path
    counted: Path

    def wait_for(self, is_so: Callable[[], bool]) -> None:
        deadline = time.monotonic() + 60
        while not is_so():
            assert time.monotonic() < deadline
            time.sleep(0.05)

    def optimize(self, on_progress: Callable[[Progress], None] | None = None, **options: object) -> Result:
        request = make_request(CASE, **options)
        return client.optimize(self.session, request, on_progress=on_progress, timeout_s=100).result()

    def kept(self) -> list[Action]:
        """Return the actions whose evaluations are in the only journal; none if there is no journal."""
        lines = [line for path in self.journal.glob("*") for line in path.read_text().splitlines()[1:]]
        return [tuple(json.loads(line)["trial"]["action"]) for line in lines]

    def computed(self) -> Counter[Action]:
        """Return how often the simulators have answered for each action."""
        return Counter(tuple(json.loads(line)) for line in self.counted.read_text().splitlines())

    def kill_orchestrator(self) -> None:
        """Kill it, and wait until it is dead."""
        (process,) = (child.process for child in self.crew._children if child.name == "orchestrator")
        assert process is not None
        process.kill()
        process.wait()

    def mend(self) -> None:
        self.wait_for(lambda: self.crew.mend() == ["orchestrator ended with exit code -9; restarted"])


@pytest.fixture(scope="module")
def shared(tmp_path_factory: pytest.TempPathFactory) -> Iterator[System]:
    folder, endpoint = tmp_path_factory.mktemp("system"), free_endpoint()
    journal, counted = folder / "journal", folder / "counted"
    environment = os.environ | {
        "FRUGAL_CONNECT": endpoint,
        "FRUGAL_LISTEN": endpoint,
        "FRUGAL_ORCHESTRATOR_JOURNAL": str(journal),
        "COUNTED_ACTIONS": str(counted),
    }
    model = f"{ROOT / 'tests' / 'served_models.py'}:CountedSimulator"
    with ExitStack() as stack:
        crew = stack.enter_context(Crew(environment=environment, log_folder=folder / "logs"))
        crew.start("router", "router")
        crew.start("heuristic", "heuristic", "--instance", "h")
        crew.start("simulator-a", "model", model, "--instance", "a")
        crew.start("simulator-b", "model", model, "--instance", "b")
        crew.start("orchestrator", "orchestrator", "--instance", "o")
        session = stack.enter_context(open_session(WireSettings(connect=(endpoint,)), wait_s=30))
        yield System(crew, session, environment, journal, counted)


@pytest.fixture
def system(shared: System) -> System:
    shared.crew.mend()
    shared.wait_for(lambda: {one.address.worker for one in client.list_workers(shared.session) if one.card} == WORKERS)
    shared.counted.write_text("")
    return shared


class Killer:
    """Kills the orchestrator when a trial of this index is told, restarts it, and notes what happened."""

    def __init__(self, system: System, *indices: int) -> None:
        self.indices = list(indices)
        self.system = system
        self.steps: list[Progress] = []
        self.kept: list[Counter[Action]] = []
        self._restarts: list[threading.Thread] = []

    def __call__(self, step: Progress) -> None:
        self.steps.append(step)
        if step.trial is not None and self.indices and step.trial.index == self.indices[0]:
            self.indices.pop(0)
            self.system.kill_orchestrator()
            computed = self.system.computed()
            self.kept.append(Counter({action: computed[action] for action in self.system.kept()}))
            self._restarts.append(threading.Thread(target=self.system.mend))
            self._restarts[-1].start()

    def join(self) -> None:
        for restart in self._restarts:
            restart.join()


def locally(**options: object) -> Result:
    """Return what an undisturbed run finds."""
    problem = Problem(TASKS["plating"], STATE, TARGET)
    return optimize(problem, {"heuristic": HeuristicModel(), "simulator": CountedSimulator()}, {}, **options)


def answer(result: Result):
    """Return what must not depend on an interruption, nor on which worker answered."""
    trials = [(trial.index, trial.action, trial.model, trial.reward, trial.error) for trial in result.trials]
    return trials, result.action, result.reward, result.heights.tobytes(), result.usage, result.models


@pytest.mark.parametrize(
    ("options", "kills"),
    [
        ({"strategy": "quality", "in_flight": 1}, (3,)),
        ({"strategy": "quality", "in_flight": 4}, (2, 6)),
        ({"strategy": "threshold", "evaluations": 24, "in_flight": 4, "seed": 7}, (5,)),
    ],
)
def test_a_run_whose_orchestrator_is_killed_ends_as_an_undisturbed_one(
    system: System, options: dict[str, object], kills: tuple[int, ...], monkeypatch: pytest.MonkeyPatch
):
    killer = Killer(system, *kills)
    result = system.optimize(on_progress=killer, **options)
    killer.join()
    assert len(killer.kept) == len(kills)
    computed = system.computed()
    monkeypatch.setenv("COUNTED_ACTIONS", os.devnull)
    assert answer(result) == answer(locally(**options))
    for kept, index in zip(killer.kept, kills, strict=True):
        assert len(kept) > index
        assert {action: computed[action] for action in kept} == kept
    assert set(killer.kept[0].values()) == {1}
    assert computed.keys() == {trial.action for trial in result.trials}
    assert sum(computed.values()) <= len(result.trials) + len(kills) * int(str(options["in_flight"]))
    (resumed,) = (event for event in result.events if event.kind == "resumed")
    assert resumed.worker == "orchestrator/o"
    assert f"{len(killer.kept[-1])} evaluations" in resumed.detail
    assert system.kept() == []
    assert [step.kind for step in killer.steps if step.kind in ("accepted", "finished")] == ["accepted", "finished"]
    assert [step.trial.index for step in killer.steps if step.trial] == list(range(len(result.trials)))


def test_without_following_its_progress_a_client_waits_for_the_restart_too(system: System):
    options = {"strategy": "quality", "in_flight": 2, "seed": 1}
    results: list[Result] = []
    caller = threading.Thread(target=lambda: results.append(system.optimize(**options)))
    caller.start()
    system.wait_for(lambda: len(system.kept()) >= 3)
    system.kill_orchestrator()
    kept = system.kept()
    time.sleep(1.0)
    system.mend()
    caller.join()
    computed = system.computed()
    assert {computed[action] for action in kept} == {1}
    again = system.optimize(**options)
    assert answer(results[0]) == answer(again)
    assert not any(event.kind == "resumed" for event in again.events)
    repeated = system.computed()
    assert all(repeated[action] > computed[action] for action in kept)


def test_an_interrupted_command_goes_on_when_it_is_given_again(system: System, tmp_path: Path):
    path = tmp_path / "case.npz"
    write_case(path, CASE)
    command = [sys.executable, "-c", INTERRUPTIBLE, "optimize", str(path), "--seed", "2", "--json"]
    command += ["--strategy", "quality", "--out", str(tmp_path / "out")]
    first = subprocess.Popen(command, cwd=ROOT, env=system.environment, stdout=subprocess.DEVNULL)
    system.wait_for(lambda: len(system.kept()) >= 2)
    first.send_signal(signal.SIGINT)
    assert first.wait(30) != 0
    kept = system.kept()
    assert len(kept) >= 2
    printed = subprocess.run(command, cwd=ROOT, env=system.environment, capture_output=True, check=True, timeout=100)
    result = json.loads(printed.stdout)
    computed = system.computed()
    assert {computed[action] for action in kept} == {1}
    assert "resumed" in [event["kind"] for event in result["events"]]
    trials = (tmp_path / "out" / "trials.jsonl").read_text().splitlines()
    undisturbed = system.optimize(strategy="quality", seed=2)
    assert (result["action"], result["reward"]) == (list(undisturbed.action), undisturbed.reward)
    assert [json.loads(line)["action"] for line in trials] == [list(trial.action) for trial in undisturbed.trials]


def test_an_orchestrator_that_does_not_come_back_is_said(system: System, monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setattr(client, "RETURN_S", 1.0)

    def on_progress(step: Progress) -> None:
        if step.kind == "accepted":
            system.kill_orchestrator()

    with pytest.raises(UnavailableError, match="expected an orchestrator behind"):
        system.optimize(on_progress=on_progress)
