"""The same system in containers. The tests run in the order of this file: the last one takes it down."""

import hashlib
import json
import socket
from collections import Counter
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from containers import ROOT, Containers

pytestmark = pytest.mark.system

MODULES = {
    "router": {"zenoh"},
    "heuristic": {"zenoh"},
    "orchestrator": {"zenoh"},
    "recorder": {"zenoh"},
    "simulator": {"zenoh", "scipy", "warp"},
    "learned": {"zenoh", "torch"},
    "mde-heuristic": {"zenoh", "torch"},
}
"""Service -> those of zenoh, scipy, warp, torch, matplotlib and pytest that its image holds, and no more."""
FIND_MODULES = """
import importlib.util, json, os
names = ["zenoh", "scipy", "warp", "torch", "matplotlib", "pytest"]
print(json.dumps({"modules": [n for n in names if importlib.util.find_spec(n)], "user": os.getuid()}))
"""


@pytest.fixture(scope="module")
def containers() -> Iterator[Containers]:
    """The system as `docker compose up` starts it; whatever an interrupted run left behind is removed first."""
    with socket.create_server(("127.0.0.1", 0)) as server:
        port = server.getsockname()[1]
    checkout = hashlib.sha256(str(ROOT).encode()).hexdigest()[:8]
    system = Containers(project=f"frugal-test-{checkout}", port=port)
    system.remove()
    try:
        system.up("--build")
        yield system
    finally:
        system.remove()


def optimize(containers: Containers, out: Path, *options: str) -> tuple[Any, list[Any]]:
    """Ask the containers for the best action of a bundled scene, from outside, and return result and trials."""
    scene = min((ROOT / "examples" / "scenes").glob("*.npz"))
    result = containers.frugal("optimize", str(scene), "--seed", "0", "--out", str(out), *options)
    return result, [json.loads(line) for line in (out / "trials.jsonl").read_text().splitlines()]


def workers(containers: Containers, model: str) -> list[Any]:
    """Return the live workers of a model."""
    return [worker for worker in containers.frugal("workers") if worker["model"] == model]


def hosts(found: list[Any]) -> set[str]:
    """Return the host names in the instances' names of workers or trials, ``<host>-<process number>``."""
    return {each["instance"].rpartition("-")[0] for each in found}


def running(containers: Containers, service: str) -> set[str]:
    """Return the host names of a service's running containers, the first part of their workers' names."""
    found = [c.id for c in containers.list() if c.service == service and c.state == "running"]
    return {containers.docker("inspect", "--format", "{{.Config.Hostname}}", name).strip() for name in found}


def test_every_service_becomes_healthy(containers: Containers) -> None:
    listed = containers.list()
    assert all(container.is_well for container in listed), containers.report()
    once = ("router", "heuristic", "learned", "mde-heuristic", "mde-learned", "orchestrator", "recorder", "warm")
    expected = {**dict.fromkeys(once, 1), "simulator": 2}
    assert Counter(container.service for container in listed) == expected


@pytest.mark.parametrize("service", MODULES)
def test_an_image_carries_what_its_service_needs_and_an_ordinary_user(containers: Containers, service: str) -> None:
    image = containers.compose("images", "--quiet", service).split()[0]
    found = json.loads(containers.docker("run", "--rm", image, "python", "-c", FIND_MODULES))
    assert set(found["modules"]) == MODULES[service]
    assert found["user"] != 0


def test_a_query_from_outside_is_answered_with_its_evidence(containers: Containers, tmp_path: Path) -> None:
    result, trials = optimize(containers, tmp_path, "--evaluations", "20", "--strategy", "only:heuristic")
    assert result["usage"] == {"heuristic": 20}
    assert result["evaluations"] == len(trials) == 20
    assert result["reward"] == max(trial["reward"] for trial in trials)
    assert hosts(trials) == running(containers, "heuristic")


@pytest.mark.parametrize("replicas", [1, 2])
def test_the_orchestrator_uses_as_many_simulators_as_there_are(
    containers: Containers, tmp_path: Path, replicas: int
) -> None:
    containers.up("--scale", f"simulator={replicas}")
    simulators = running(containers, "simulator")
    assert len(simulators) == replicas
    containers.wait_until(lambda: hosts(workers(containers, "simulator")) == simulators)
    options = ("--strategy", "only:simulator", "--evaluations", "4", "--in-flight", "2")
    result, trials = optimize(containers, tmp_path, *options)
    assert result["usage"] == {"simulator": 4}
    assert hosts(trials) == simulators


def test_the_mdes_in_containers_choose_among_the_models(containers: Containers, tmp_path: Path) -> None:
    result, trials = optimize(containers, tmp_path, "--strategy", "threshold", "--evaluations", "20")
    assert {event["kind"] for event in result["events"]} <= {"unfamiliar"}  # corners that no training action is in
    assert all(set(trial["estimates"]) <= {"heuristic", "learned"} and trial["estimates"] for trial in trials)
    assert len(result["usage"]) > 1


def test_a_worker_that_crashes_is_back_and_serves(containers: Containers, tmp_path: Path) -> None:
    kill_all_but_init = "import os, signal; os.kill(-1, signal.SIGKILL)"
    containers.compose("exec", "--detach", "heuristic", "python", "-c", kill_all_but_init)
    (crashed,) = (container.id for container in containers.list() if container.service == "heuristic")
    containers.wait_until(lambda: int(containers.docker("inspect", "--format", "{{.RestartCount}}", crashed)) > 0)
    containers.up()
    result, _ = optimize(containers, tmp_path, "--evaluations", "5", "--strategy", "only:heuristic")
    assert result["usage"] == {"heuristic": 5}


def test_a_trial_reported_from_outside_is_in_the_volume_also_after_a_restart(
    containers: Containers, tmp_path: Path
) -> None:
    scene = ROOT / "examples" / "scenes" / "04-medallion-bare.npz"
    options = ("trials", "report", str(scene), "--robot", "arm-1", "--id", "first")
    kept = containers.frugal(*options)
    containers.compose("restart", "recorder")
    containers.up()
    assert containers.frugal(*options) == kept
    containers.compose("cp", "recorder:/var/lib/frugal/trials/.", str(tmp_path))
    assert [path.name for path in tmp_path.iterdir()] == [kept["file"]]


def test_every_process_stops_when_asked(containers: Containers) -> None:
    containers.compose("stop")
    assert {container.name: container.exit_code for container in containers.list() if container.exit_code} == {}


def test_down_leaves_no_container_no_volume_and_no_network(containers: Containers) -> None:
    containers.compose("down", "--volumes")
    mine = ("--quiet", "--filter", f"label=com.docker.compose.project={containers.project}")
    assert containers.docker("ps", "--all", *mine) == ""
    assert containers.docker("volume", "ls", *mine) == ""
    assert containers.docker("network", "ls", *mine) == ""


def test_the_official_router_is_one_file_away(containers: Containers) -> None:
    files = ("--file", "docker-compose.yml", "--file", "deploy/compose.eclipse-zenoh.yml")
    router = json.loads(containers.compose(*files, "config", "--format", "json"))["services"]["router"]
    assert router["image"].startswith("eclipse/zenoh:")
    assert "build" not in router
    assert [volume["source"] for volume in router["volumes"]] == [str(ROOT / "deploy" / "zenoh" / "router.json5")]
