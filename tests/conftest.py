"""A router in a process of its own, sessions on it, and fake workers."""

import subprocess
from collections.abc import Callable, Iterator
from contextlib import ExitStack
from pathlib import Path

import pytest

from common.wire.directory import Directory
from common.wire.session import Session, open_session
from common.wire.settings import WireSettings
from tests import fakes

Start = Callable[..., subprocess.Popen[bytes]]
START_S = 30.0


@pytest.fixture(scope="module")
def endpoint(tmp_path_factory: pytest.TempPathFactory) -> Iterator[str]:
    """Return the endpoint of a router that runs as long as the module's tests."""
    found = fakes.free_endpoint()
    with fakes.running("router", endpoint=found, log=tmp_path_factory.mktemp("router") / "log"):
        yield found


@pytest.fixture(scope="module")
def settings(endpoint: str) -> WireSettings:
    return WireSettings(connect=(endpoint,), listen=(endpoint,))


@pytest.fixture(scope="module")
def session(settings: WireSettings) -> Iterator[Session]:
    """Return a client session."""
    with open_session(settings, wait_s=START_S) as opened:
        yield opened


@pytest.fixture
def directory(session: Session) -> Iterator[Directory]:
    """Return who is alive for plating."""
    found = Directory(session, task="plating")
    yield found
    found.close()


@pytest.fixture
def start(endpoint: str, directory: Directory, tmp_path: Path) -> Iterator[Start]:
    """Return what starts a fake worker: kind, name, instance and optionally the queue's length."""
    started: set[str] = set()
    with ExitStack() as stack:

        def start_one(*arguments: object) -> subprocess.Popen[bytes]:
            started.add(str(arguments[2]))
            worker = fakes.running(*map(str, arguments), endpoint=endpoint, log=tmp_path / "log")
            return stack.enter_context(worker)

        yield start_one
    while left := [one.address for one in directory.workers() if one.address.instance in started]:
        directory.wait_for_change(0.1)
        for address in left:
            directory.probe(address)  # the end of a token is not always told
