"""The health check of containers: it is right about one process, whatever the others do."""

import socket
from collections.abc import Iterator

import pytest

from common.domain.errors import RequestError, UnavailableError
from common.wire.probe import health_key, probe
from common.wire.serve import host_model
from common.wire.session import open_router, open_session
from common.wire.settings import WireSettings
from services.heuristic import HeuristicModel


@pytest.fixture
def endpoint() -> Iterator[str]:
    """The endpoint of a router with one heuristic worker, ``here-1``."""
    with socket.create_server(("127.0.0.1", 0)) as server:
        endpoint = f"tcp/127.0.0.1:{server.getsockname()[1]}"
    settings = WireSettings(connect=(endpoint,), listen=(endpoint,))
    with open_router(settings), open_session(settings) as session:
        host = host_model(session, HeuristicModel(), task="plating", instance="here-1")
        host.start()
        yield endpoint
        host.stop(grace_s=1.0)


@pytest.mark.parametrize("instance", ["here-1", "here-$*"])
def test_a_worker_that_answers_is_well(endpoint: str, instance: str) -> None:
    probe(health_key("heuristic", instance=instance), connect=[endpoint])


@pytest.mark.parametrize(("name", "instance"), [("heuristic", "there-$*"), ("simulator", "here-1")])
def test_the_answer_of_another_worker_does_not_count(endpoint: str, name: str, instance: str) -> None:
    with pytest.raises(UnavailableError, match="expected an answer"):
        probe(health_key(name, instance=instance), connect=[endpoint])


def test_an_mde_is_named_with_its_model() -> None:
    assert health_key("mde/learned", instance="a") == "frugal/@v1/*/mde/learned/a/health"


@pytest.mark.parametrize("role", ["orchestrator", "recorder", "world"])
def test_a_worker_without_a_model_is_named_by_its_role(role: str) -> None:
    assert health_key(role, instance="a") == f"frugal/@v1/*/{role}/a/health"


def test_a_name_of_no_role_is_refused() -> None:
    with pytest.raises(RequestError, match="expected a model, mde/<model> or a role without one"):
        health_key("nowhere/learned", instance="a")


def test_a_router_that_answers_is_well(endpoint: str) -> None:
    probe(None, connect=[endpoint])


def test_without_a_router_nothing_is_well() -> None:
    with pytest.raises(UnavailableError, match="expected a router"):
        probe(None, connect=["tcp/127.0.0.1:9"])
