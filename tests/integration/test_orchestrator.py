"""The orchestrator as a process, over workers of which some fail."""

import signal
import subprocess
import time
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import ExitStack
from pathlib import Path

import numpy as np
import pytest

from common.domain.errors import ModelError, RequestError, TimedOutError, UnavailableError
from common.domain.grid import Grid
from common.domain.scene import Item, Scene, State
from common.domain.trial import Result, Trial
from common.planning.optimize import optimize
from common.planning.problem import Problem
from common.tasks import TASKS
from common.wire import client
from common.wire.array import Array
from common.wire.optimization import OptimizeRequest, Progress
from common.wire.session import Session, open_session
from common.wire.settings import WireSettings
from common.wire.state import StateMessage
from tests.fakes import Tilted, free_endpoint, make_state, running, serving

STATE = make_state()
TRUE_ACTION = (0.0123, -0.0057)
TARGET = Tilted().predict(STATE, np.array([TRUE_ACTION])).heights[0]
EVALUATIONS = 24
LOOP = {"strategy": "threshold", "evaluations": EVALUATIONS, "seed": 7}


class System:
    """A router and an orchestrator, and workers that tests start and that end with their test."""

    def __init__(self, stack: ExitStack, folder: Path) -> None:
        self.log = folder / "processes.log"
        self.endpoint = free_endpoint()
        self.router = stack.enter_context(running("router", endpoint=self.endpoint, log=self.log))
        stack.enter_context(serving("orchestrator", "--instance", "o", endpoint=self.endpoint, log=self.log))
        self.session: Session = stack.enter_context(open_session(WireSettings(connect=(self.endpoint,)), wait_s=20))
        self.workers = ExitStack()
        self.wait_for(lambda names: "orchestrator/o" in names)

    def spawn(self, kind: str, instance: str) -> subprocess.Popen[bytes]:
        """Start a fake of the model `simulator`."""
        fake = running(kind, "simulator", instance, endpoint=self.endpoint, log=self.log)
        return self.workers.enter_context(fake)

    def start(self, kind: str, instance: str) -> subprocess.Popen[bytes]:
        """Start a fake of the model `simulator` and wait until it is alive."""
        process = self.spawn(kind, instance)
        self.wait_for(lambda names: f"simulator/{instance}" in names)
        return process

    def wait_for(self, is_so: Callable[[set[str]], bool]) -> None:
        deadline = time.monotonic() + 20
        while not is_so({status.address.worker for status in client.list_workers(self.session)}):
            assert time.monotonic() < deadline, self.log.read_text()
            time.sleep(0.02)

    def wait_until_known(self, is_known: Callable[[Result], bool]) -> None:
        """Wait until the orchestrator, which is told of workers apart from this process, shows that it knows them."""
        deadline = time.monotonic() + 20
        while not is_known(self.optimize(evaluations=4)):
            assert time.monotonic() < deadline, self.log.read_text()

    def optimize(self, on_progress: Callable[[Progress], None] | None = None, **options: object) -> Result:
        return client.optimize(self.session, a_request(**options), on_progress=on_progress, timeout_s=60).result()


@pytest.fixture(scope="module")
def shared(tmp_path_factory: pytest.TempPathFactory) -> Iterator[System]:
    with ExitStack() as stack:
        yield System(stack, tmp_path_factory.mktemp("system"))


@pytest.fixture
def system(shared: System) -> Iterator[System]:
    with shared.workers:
        yield shared
    shared.wait_for(lambda names: names == {"orchestrator/o"})
    shared.workers = ExitStack()


def a_request(**options: object) -> OptimizeRequest:
    fields = {"state": StateMessage.of(STATE), "target": Array.of(TARGET), **LOOP}
    return OptimizeRequest.model_validate(fields | options)


def locally(*, in_flight: int) -> Result:
    problem = Problem(TASKS["plating"], STATE, TARGET)
    model = Tilted("simulator")
    return optimize(problem, {"simulator": model}, {}, **LOOP, in_flight=in_flight)


def what(trials: tuple[Trial, ...]) -> list[tuple[object, ...]]:
    return [(trial.index, trial.action, trial.model, trial.version, trial.reward) for trial in trials]


@pytest.mark.parametrize("in_flight", [1, 4])
def test_the_same_seed_gives_the_same_trials_remotely_and_locally(system: System, in_flight: int):
    system.start("good", "a")
    system.start("good", "b")
    first, second = (system.optimize(in_flight=in_flight) for _ in range(2))
    assert what(first.trials) == what(second.trials) == what(locally(in_flight=in_flight).trials)
    assert np.array_equal(first.heights, locally(in_flight=in_flight).heights)
    assert np.hypot(*np.subtract(first.action, TRUE_ACTION)) < 2e-3
    assert first.usage == {"simulator": EVALUATIONS}
    assert first.models == {"simulator": "1"}
    assert {trial.instance for trial in first.trials} == {"a", "b"}


@pytest.mark.parametrize("strategy", ["threshold", "quality"])
def test_the_simulator_stays_applicable_with_an_mde_of_its_own_alive(system: System, strategy: str):
    system.start("good", "a")
    without = system.optimize(strategy=strategy)
    system.workers.enter_context(running("mde", "simulator", "m", endpoint=system.endpoint, log=system.log))
    system.wait_until_known(lambda result: "simulator" in result.trials[-1].estimates)
    result = system.optimize(strategy=strategy)
    assert what(result.trials) == what(without.trials)
    radius = [min(10 * float(np.hypot(*trial.action)), 1.0) for trial in result.trials]
    assert [trial.estimates["simulator"] for trial in result.trials] == pytest.approx(radius)


@pytest.mark.parametrize("replicas", [1, 3])
def test_by_default_as_many_evaluations_are_in_flight_as_there_are_replicas(system: System, replicas: int):
    for instance in "abc"[:replicas]:
        system.start("good", instance)
    system.wait_until_known(lambda result: result.in_flight >= replicas)
    result = system.optimize()
    assert result.in_flight == replicas
    assert what(result.trials) == what(locally(in_flight=replicas).trials)


@pytest.mark.parametrize("deadline_s", [0.3, 1.0])
def test_a_deadline_ends_a_search_whose_models_are_slow(system: System, deadline_s: float):
    system.start("slow" if deadline_s > 0.5 else "good", "a")
    system.optimize(evaluations=1)
    began = time.monotonic()
    result = system.optimize(evaluations=5000, deadline_s=deadline_s)
    took_s = time.monotonic() - began
    assert result.wall_s <= took_s < deadline_s + 10  # benchmarks/deadline.py measures it
    assert result.wall_s < deadline_s + 2
    assert result.reward == max(trial.reward for trial in result.trials if trial.reward is not None)
    assert len(result.trials) < 5000


def test_a_cheap_model_is_swept_again_and_also_after_the_trusted_one_was_measured_alone(tmp_path: Path):
    with ExitStack() as stack:
        system = System(stack, tmp_path)  # of its own: this one has measured nothing yet
        stack.enter_context(system.workers)
        system.start("slow", "a")
        system.optimize(strategy="only:simulator", evaluations=2)
        system.workers.enter_context(running("good", "heuristic", "h", endpoint=system.endpoint, log=system.log))
        system.wait_for(lambda names: "heuristic/h" in names)
        # One call, so that the heuristic is asked in large batches only.
        first = (system.optimize(strategy="transport:calls=1").usage for _ in range(20))
        assert any(
            "heuristic" in usage for usage in first
        )  # the orchestrator reads its card some time after it is alive
        for _ in range(2):
            assert system.optimize(strategy="transport:calls=1").usage["heuristic"] > 100


@pytest.mark.parametrize("failure", [signal.SIGKILL, signal.SIGSTOP])
def test_a_worker_that_dies_or_stops_takes_nothing_with_it(system: System, failure: signal.Signals):
    system.start("slow", "good")
    victim = system.start("slow", "victim")
    seen: list[Progress] = []

    def on_progress(step: Progress) -> None:
        seen.append(step)
        if sum(step.kind == "trial" for step in seen) == 3 and victim.returncode is None:
            victim.send_signal(failure)

    result = system.optimize(on_progress=on_progress, in_flight=4)
    assert what(result.trials) == what(locally(in_flight=4).trials)
    assert all(trial.error == "" for trial in result.trials)
    assert any(event.worker == "simulator/victim" for event in result.events)
    assert [step.trial.index for step in seen if step.trial] == list(range(EVALUATIONS))


@pytest.mark.parametrize("kind", ["raising", "lying", "infinite"])
def test_a_worker_that_fails_is_replaced_by_one_that_does_not(system: System, kind: str):
    system.start("good", "good")
    system.start(kind, "bad")
    result = system.optimize(in_flight=4)
    assert what(result.trials) == what(locally(in_flight=4).trials)
    assert any(event.worker == "simulator/bad" and event.kind == "model_error" for event in result.events)
    assert {trial.instance for trial in result.trials} == {"good"}


def test_a_worker_that_joins_in_the_middle_gets_work(system: System):
    system.start("slow", "first")
    started: list[object] = []

    def on_progress(step: Progress) -> None:
        if step.kind == "trial" and not started:
            started.append(system.spawn("slow", "second"))

    result = system.optimize(on_progress=on_progress, in_flight=4)
    assert {trial.instance for trial in result.trials} == {"first", "second"}
    assert any(event.kind == "joined" and event.worker == "simulator/second" for event in result.events)


def test_without_any_worker_the_error_names_what_is_missing_within_two_seconds(system: System):
    began = time.monotonic()
    with pytest.raises(UnavailableError, match="model simulator"):
        system.optimize()
    assert time.monotonic() - began < 2


def test_workers_that_all_fail_give_their_error(system: System):
    system.start("raising", "bad")
    with pytest.raises(ModelError, match="the solver diverged"):
        system.optimize()


def test_a_model_without_an_mde_is_used_only_if_it_is_named(system: System):
    system.start("good", "a")
    result = system.optimize(strategy="only:simulator")
    assert result.usage == {"simulator": EVALUATIONS}
    with pytest.raises(UnavailableError, match="model learned"):
        system.optimize(strategy="only:learned")


def test_at_the_deadline_the_best_known_action_is_the_answer(system: System):
    system.start("slow", "a")
    began = time.monotonic()
    result = system.optimize(deadline_s=1.5)
    assert time.monotonic() - began < 2.5
    assert 0 < sum(trial.reward is not None for trial in result.trials) < EVALUATIONS


def test_a_caller_with_a_short_budget_gets_the_best_known_action_in_time(system: System):
    system.start("slow", "a")
    reply = client.optimize(system.session, a_request(), timeout_s=2.0)
    assert reply.trials


def test_a_budget_too_short_for_one_evaluation_is_an_error(system: System):
    system.start("slow", "a")
    with pytest.raises(TimedOutError):
        system.optimize(deadline_s=0.05)


def test_a_late_subscriber_gets_every_step(system: System):
    system.start("good", "a")
    result = system.optimize(id="late")
    steps: list[Progress] = []
    with client.follow_progress(system.session, steps.append, request_id="late"):
        deadline = time.monotonic() + 10
        while not any(step.kind == "finished" for step in steps):
            assert time.monotonic() < deadline, steps
            time.sleep(0.02)
    assert [step.index for step in steps] == list(range(len(steps)))
    assert [step.trial.trial() for step in steps if step.trial] == list(result.trials)
    assert steps[-1].action == result.action


BAD_REQUESTS = {
    "another task": ({"task": "cooking"}, "task: expected plating"),
    "an unknown strategy": ({"strategy": "guess"}, "strategy: expected one of"),
    "empty bounds": ({"bounds": ((0.01, 0.01), (0.0, 0.02))}, "low < high"),
    "bounds of another dimension": ({"bounds": ((0.0, 0.01),)}, "expected 2 action parameters, got 1"),
    "bounds beyond the task's": ({"bounds": ((-1.0, 1.0), (-1.0, 1.0))}, "expected them within"),
    "no evaluations": ({"evaluations": 0}, "evaluations"),
    "a million evaluations": ({"evaluations": 10**6}, "evaluations"),
    "a target of another grid": ({"target": Array.of(np.zeros((9, 10), np.float32))}, r"expected shape \(8, 10\)"),
    "a target that is not finite": ({"target": Array.of(np.full((8, 10), np.nan, np.float32))}, "finite"),
    "a trusted model that is not there": ({"trusted": "oracle"}, "model oracle"),
}


@pytest.mark.parametrize("case", BAD_REQUESTS)
def test_a_bad_request_is_refused_with_a_reason_and_the_next_one_served(system: System, case: str):
    changes, reason = BAD_REQUESTS[case]
    system.start("good", "a")
    request = a_request().model_copy(update=changes)
    with pytest.raises((RequestError, UnavailableError), match=reason):
        client.optimize(system.session, request, timeout_s=10)
    assert system.optimize(evaluations=3).usage == {"simulator": 3}


def test_several_optimisations_run_at_once(system: System):
    system.start("slow", "a")
    system.start("slow", "b")
    steps: list[Progress] = []
    with ExitStack() as stack:
        for name in ("run-0", "run-1", "run-2"):
            stack.enter_context(client.follow_progress(system.session, steps.append, request_id=name))
        pool = stack.enter_context(ThreadPoolExecutor(3))
        results = list(pool.map(lambda n: system.optimize(id=f"run-{n}", seed=n, evaluations=6), range(3)))
        deadline = time.monotonic() + 20  # a last step may come after its answer
        while sum(step.kind == "finished" for step in steps) < 3 and time.monotonic() < deadline:
            time.sleep(0.02)
    assert [result.seed for result in results] == [0, 1, 2]
    kinds = [step.kind for step in steps if step.kind in ("accepted", "finished")]
    assert kinds == ["accepted"] * 3 + ["finished"] * 3


def test_an_optimisation_outlives_the_loss_of_its_connections(tmp_path: Path):
    with ExitStack() as stack:
        system = System(stack, tmp_path)
        stack.enter_context(system.workers)
        system.start("slow", "a")
        steps: list[Progress] = []

        def on_progress(step: Progress) -> None:
            steps.append(step)
            if sum(step.kind == "trial" for step in steps) == 3 and system.router.poll() is None:
                system.router.kill()
                system.router.wait()
                stack.enter_context(running("router", endpoint=system.endpoint, log=system.log))

        result = system.optimize(on_progress=on_progress)
        assert what(result.trials) == what(locally(in_flight=1).trials)
        evaluated = [step.trial.index for step in steps if step.trial]
        assert evaluated == list(range(EVALUATIONS))


def test_after_a_deadline_nothing_goes_on(system: System):
    process = system.start("slow", "a")
    system.optimize(deadline_s=1.0, in_flight=4)
    deadline = time.monotonic() + 10
    while True:
        (worker,) = (s for s in client.list_workers(system.session) if s.address.worker == "simulator/a")
        if worker.health is not None and worker.health.in_progress + worker.health.queue_length == 0:
            break
        assert time.monotonic() < deadline
    served = worker.health.served
    time.sleep(1.0)
    (worker,) = (s for s in client.list_workers(system.session) if s.address.worker == "simulator/a")
    assert process.poll() is None
    assert worker.health is not None
    assert worker.health.served == served


def test_a_model_of_another_grid_is_the_requests_fault(system: System):
    system.start("good", "a")
    grid, empty = Grid(12, 10, 0.01), np.zeros((3, 12, 10), np.float32)
    item = Item(np.full((12, 10), 0.01, np.float32), np.full((3, 12, 10), 0.4, np.float32))
    wide = State(Scene(grid, empty[0], empty), item)
    request = a_request(state=StateMessage.of(wide), target=Array.of(wide.scene.heights))
    with pytest.raises(RequestError, match="grid: expected one that simulator takes"):
        client.optimize(system.session, request, timeout_s=10)


def test_when_the_only_worker_stops_the_error_names_the_model(system: System):
    victim = system.start("slow", "only")

    def on_progress(step: Progress) -> None:
        if step.kind == "trial":
            victim.send_signal(signal.SIGSTOP)

    with pytest.raises((UnavailableError, TimedOutError), match="simulator"):
        system.optimize(on_progress=on_progress)
