"""Tiny models and estimators, some of which exist only to fail, and the processes that run them."""

import argparse
import hashlib
import json
import logging
import os
import signal
import socket
import subprocess
import sys
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import AbstractContextManager, contextmanager
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from common.domain.bodies import Bodies, Box, Material, Plate
from common.domain.deviation import DeviationEstimator, Estimates
from common.domain.errors import ModelError
from common.domain.grid import Floats, Grid
from common.domain.model import Predictions, PredictiveModel
from common.domain.scene import Item, Scene, State
from common.wire.call import Call
from common.wire.endpoint import Alias, Endpoint
from common.wire.host import Host
from common.wire.messages import Card
from common.wire.optimization import OptimizeReply, OptimizeRequest, Progress, TrialMessage
from common.wire.router import run_router
from common.wire.run import run_host
from common.wire.serve import host_estimator, host_model
from common.wire.session import Session
from common.wire.settings import WireSettings

GRID = Grid(8, 10, 0.01)


def make_state(seed: int = 0, *, bodies: bool = False) -> State:
    """Return a small state whose numbers come from a seed."""
    rng = np.random.default_rng(seed)
    heights = rng.uniform(0, 0.02, GRID.shape).astype(np.float32)
    item = np.zeros(GRID.shape, dtype=np.float32)
    item[3:5, 4:7] = 0.01
    materials = np.zeros((3, *GRID.shape), dtype=np.float32)
    materials[:, item > 0] = np.array([[1000.0], [1e5], [0.4]])
    known = None
    if bodies:
        turn = rng.normal(size=4)
        box = Box(rng.uniform(0.01, 0.05, 3), rng.normal(size=3), turn / np.linalg.norm(turn), Material(500, 1e6, 0.3))
        known = Bodies(Plate(np.array([0.0, 0.08, 0.12]), np.array([0.0, 0.0, 0.02])), (box, box))
    return State(Scene(GRID, heights, np.zeros_like(materials), known), Item(item, materials))


class Tilted(PredictiveModel):
    """Adds the item to the scene and tilts it by the action: cheap, and exact to check."""

    version = "1"
    largest_batch = 32

    def __init__(self, name: str = "tilted") -> None:
        self.name = name

    def outcomes(self, state: State, actions: NDArray[np.float64]) -> tuple[Floats, tuple[str, ...]]:
        x, y = state.grid.x[None, None, :], state.grid.y[None, :, None]
        tilt = actions[:, 0, None, None] * x + actions[:, 1, None, None] * y
        return (state.scene.heights + state.item.heights + tilt).astype(np.float32), ("",) * len(actions)


class Slow(Tilted):
    """Takes its time."""

    def __init__(self, name: str = "tilted", *, seconds: float = 0.3) -> None:
        super().__init__(name)
        self.seconds = seconds

    def outcomes(self, state: State, actions: NDArray[np.float64]) -> tuple[Floats, tuple[str, ...]]:
        time.sleep(self.seconds)
        return super().outcomes(state, actions)


class Raising(Tilted):
    """Raises something that is no error of ours."""

    def outcomes(self, state: State, actions: NDArray[np.float64]) -> tuple[Floats, tuple[str, ...]]:
        raise ZeroDivisionError("the solver diverged")


class Lying(Tilted):
    """Answers heightmaps of the wrong shape, past the checks of its own process."""

    def predict(self, state: State, actions: Floats) -> Predictions:
        return Predictions(np.zeros((1, 2, 3), dtype=np.float32), ("",), self.name, self.version)


class Infinite(Tilted):
    """Answers infinite heights, past the checks of its own process."""

    def predict(self, state: State, actions: Floats) -> Predictions:
        heights = np.full((len(actions), *state.grid.shape), np.inf, dtype=np.float32)
        return Predictions(heights, ("",) * len(actions), self.name, self.version)


class Radius(DeviationEstimator):
    """Calls the distance from the origin, in decimetres, the deviation."""

    version = "1"

    def __init__(self, model: str = "tilted") -> None:
        self.model = model

    def deviations(self, state: State, actions: NDArray[np.float64]) -> Estimates:
        mean = np.minimum(10 * np.linalg.norm(actions, axis=1), 1.0)
        return Estimates(mean, np.minimum(1.5 * mean, 1.0), mean < 0.5)


class RaisingEstimator(Radius):
    """Raises."""

    def deviations(self, state: State, actions: NDArray[np.float64]) -> Estimates:
        raise ModelError("no weights")


class SlowRadius(Radius):
    """Takes its time."""

    def deviations(self, state: State, actions: NDArray[np.float64]) -> Estimates:
        time.sleep(2.0)
        return super().deviations(state, actions)


def load_radius(kind: type[Radius], instance: str) -> Callable[[bytes, bytes], tuple[DeviationEstimator, str]]:
    """Return what makes such an estimator of a card; the instance ``picky`` refuses, ``mortal`` dies of it."""

    def load(card: bytes, tensors: bytes) -> tuple[DeviationEstimator, str]:
        told, digest = json.loads(card), hashlib.sha256(tensors).hexdigest()
        if instance == "mortal":
            os._exit(1)
        if instance == "picky" or digest != told["sha256"]:
            raise ModelError(f"expected other weights than version {told['version']}")
        found = kind(told["name"].removeprefix("mde_"))
        found.version = told["version"]
        return found, digest

    return load


MODELS: dict[str, Callable[[str], PredictiveModel]] = {
    "good": Tilted,
    "slow": Slow,
    "stuck": lambda name: Slow(name, seconds=3600),
    "raising": Raising,
    "lying": Lying,
    "infinite": Infinite,
}


def pretend_to_optimize(request: OptimizeRequest, call: Call) -> OptimizeReply:
    """Publish one trial after the other, 20 ms each, and answer with the last."""
    call.publish(Progress(kind="accepted", strategy=request.strategy, evaluations=request.evaluations))
    trials: list[TrialMessage] = []
    for index in range(request.evaluations):
        if call.cancelled() or call.remaining() <= 0:
            break
        time.sleep(0.02)
        trials.append(
            TrialMessage(
                index=index, action=(0.0, 0.01), model="m", instance="i", version="1", reward=-1.0 / (index + 1)
            )
        )
        call.publish(Progress(kind="trial", trial=trials[-1]))
    if request.strategy == "raise":
        raise ModelError("told to fail")
    call.publish(Progress(kind="finished", action=(0.0, 0.01), reward=trials[-1].reward))
    return OptimizeReply(
        id=request.id,
        task=request.task,
        action=(0.0, 0.01),
        reward=trials[-1].reward or 0.0,
        heights=request.target,
        trials=tuple(trials),
        usage={"m": len(trials)},
        models={"m": "1"},
        split_s={"m": 0.02 * len(trials)},
        wall_s=0.02 * len(trials),
        events=(),
        strategy=request.strategy,
        seed=request.seed,
        instance=call.id,
    )


def build(kind: str, name: str, instance: str, queue_length: int) -> Callable[[Session], Host]:
    """Return what makes the host of a fake: a model by its behaviour, ``orchestrator``, or an MDE.

    MDEs are ``mde``, ``mde-raising``, and ``mde-loading`` and ``mde-loading-slow``, which take other weights over.
    """
    if kind == "orchestrator":
        card = Card(task="plating", role="orchestrator", model=None, instance=instance, version="1")
        endpoint = Endpoint(
            "optimize",
            OptimizeRequest,
            pretend_to_optimize,
            aliases=(Alias("frugal/@v1/plating/optimize"),),
            unique_ids=True,
        )
        return lambda session: Host(session, card, [endpoint], threads=2, queue_length=queue_length)
    options = {"task": "plating", "instance": instance}
    if kind in ("mde-loading", "mde-loading-slow"):
        made = Radius if kind == "mde-loading" else SlowRadius
        load = load_radius(made, instance)
        return lambda session: host_estimator(session, made(name), queue_length=queue_length, load=load, **options)
    if kind in ("mde", "mde-raising"):
        estimator = Radius(name) if kind == "mde" else RaisingEstimator(name)
        return lambda session: host_estimator(session, estimator, queue_length=queue_length, **options)
    grid = GRID if kind == "good" else None
    return lambda session: host_model(session, MODELS[kind](name), queue_length=queue_length, grid=grid, **options)


def free_endpoint() -> str:
    """Return a Zenoh endpoint on this machine that nobody listens on."""
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        return f"tcp/127.0.0.1:{probe.getsockname()[1]}"


def spawn(*arguments: str, endpoint: str, log: Path, command: Sequence[str] = (__file__,)) -> subprocess.Popen[bytes]:
    """Start a fake in a process of its own: ``router``, or kind, name, instance and optionally the queue's length."""
    environment = {**os.environ, "FRUGAL_CONNECT": endpoint, "FRUGAL_LISTEN": endpoint, "FRUGAL_GRACE_S": "1"}
    with log.open("ab") as output:
        return subprocess.Popen(
            [sys.executable, *command, *arguments],
            env=environment,
            stdout=output,
            stderr=output,
        )


@contextmanager
def running(
    *arguments: str, endpoint: str, log: Path, command: Sequence[str] = (__file__,)
) -> Iterator[subprocess.Popen[bytes]]:
    """Start a fake, and kill it at the end if it still runs."""
    process = spawn(*arguments, endpoint=endpoint, log=log, command=command)
    try:
        yield process
    finally:
        if process.poll() is None:
            process.send_signal(signal.SIGCONT)
            process.kill()
        process.wait()


def serving(*arguments: str, endpoint: str, log: Path) -> AbstractContextManager[subprocess.Popen[bytes]]:
    """Start ``frugal serve`` with these arguments, and kill it at the end if it still runs."""
    return running(*arguments, endpoint=endpoint, log=log, command=("-m", "services.cli.main", "serve"))


def main() -> int:
    """Run one fake until it is told to stop."""
    logging.basicConfig(level=logging.INFO)
    parser = argparse.ArgumentParser()
    parser.add_argument("kind")
    parser.add_argument("name", nargs="?", default="tilted")
    parser.add_argument("instance", nargs="?", default="a")
    parser.add_argument("queue_length", nargs="?", type=int, default=16)
    options = parser.parse_args()
    if options.kind == "router":
        return run_router(WireSettings())
    return run_host(build(options.kind, options.name, options.instance, options.queue_length), WireSettings())


if __name__ == "__main__":
    raise SystemExit(main())
