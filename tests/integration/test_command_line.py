"""The command line: errors in one line, and no process left behind."""

import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

from common.wire.client import list_workers
from common.wire.session import open_session
from common.wire.settings import WireSettings
from services.cli.main import COMMANDS
from services.cli.processes import Crew
from tests.fakes import free_endpoint

ROOT = Path(__file__).parents[2]


def environment(endpoint: str) -> dict[str, str]:
    return os.environ | {"FRUGAL_CONNECT": endpoint, "FRUGAL_LISTEN": endpoint}


def frugal(*arguments: object, endpoint: str) -> subprocess.CompletedProcess[str]:
    command = [sys.executable, "-m", "services.cli.main", *map(str, arguments)]
    return subprocess.run(
        command, cwd=ROOT, env=environment(endpoint), capture_output=True, text=True, timeout=60, check=False
    )


@pytest.mark.parametrize(
    ("arguments", "expected"),
    [
        (("optimize", "no-such-scene"), "expected a case file or one of"),
        (("optimize", "README.md"), "expected a case file"),
        (("workers",), "expected a Zenoh router at"),
        (("serve", "model", "nowhere.py:Model"), "expected FILE.py:CLASS with an existing file"),
        (("serve", "model", "examples/fourth_model.py:Missing"), "expected a subclass of PredictiveModel"),
        (("health", "router"), "expected"),
        (("optimize", "04-medallion-bare", "--d-max", "0"), "d-max"),
        (("optimize", "04-medallion-bare", "--seed", "99999999999999999999"), "seed"),
    ],
)
def test_an_error_is_one_line_that_says_expected_and_got(arguments: tuple[str, ...], expected: str):
    done = frugal(*arguments, endpoint=free_endpoint())
    assert done.returncode in (1, 2)
    assert done.stdout == ""
    assert expected in done.stderr.splitlines()[-1]
    assert "Traceback" not in done.stderr


def test_a_setting_that_makes_no_sense_is_one_line():
    command = [sys.executable, "-m", "services.cli.main", "workers"]
    settings = os.environ | {"FRUGAL_LEASE_S": "abc"}
    done = subprocess.run(command, cwd=ROOT, env=settings, capture_output=True, text=True, timeout=60, check=False)
    assert done.returncode == 1
    assert "FRUGAL_LEASE_S: expected a valid number" in done.stderr
    assert "Traceback" not in done.stderr


def test_a_second_system_at_the_same_endpoint_is_refused():
    endpoint = free_endpoint()
    with Crew(environment=environment(endpoint)) as crew:
        crew.start("router", "router")
        with open_session(WireSettings(connect=(endpoint,)), wait_s=20):
            done = frugal("up", endpoint=endpoint)
    assert done.returncode == 1
    assert "is the system up already?" in done.stderr


def test_help_names_every_command_and_imports_none_of_them():
    code = (
        "import sys; sys.argv = ['frugal', '--help']\n"
        "from services.cli.main import COMMANDS, main\n"
        "try: main()\n"
        "except SystemExit as stop: assert not stop.code, stop.code\n"
        "heavy = {'zenoh', 'numpy', 'pydantic', 'warp', 'matplotlib', 'rich'} & set(sys.modules)\n"
        "assert not heavy, heavy\n"
    )
    done = subprocess.run([sys.executable, "-c", code], cwd=ROOT, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    for name in COMMANDS:
        assert f"\n  {name} " in done.stdout


def test_a_crew_stops_all_its_processes_and_restarts_one_that_ended(tmp_path: Path):
    endpoint = free_endpoint()
    with Crew(environment=environment(endpoint), log_folder=tmp_path) as crew:
        crew.start("router", "router")
        crew.start("heuristic", "heuristic", "--instance", "h")
        with open_session(WireSettings(connect=(endpoint,)), wait_s=20) as session:
            first = process_of(session)
            os.kill(first, signal.SIGKILL)
            deadline = time.monotonic() + 20
            while not (news := crew.mend()):
                assert time.monotonic() < deadline
                time.sleep(0.05)
            assert news == ["heuristic ended with exit code -9; restarted"]
            second = process_of(session, other_than=first)
    assert not is_running(first)
    assert not is_running(second)


def process_of(session, *, other_than: int | None = None) -> int:
    """Return the process number of the heuristic worker once it is alive."""
    deadline = time.monotonic() + 20
    while time.monotonic() < deadline:
        if any(status.health for status in list_workers(session)):
            found = [int(pid) for pid in child_processes() if int(pid) != other_than]
            if found:
                return found[0]
        time.sleep(0.05)
    raise AssertionError("no heuristic worker came up")


def child_processes() -> list[str]:
    done = subprocess.run(
        ["pgrep", "-P", str(os.getpid()), "-f", "serve --until-eof heuristic"],
        capture_output=True, text=True, check=False,
    )  # fmt: skip
    return done.stdout.split()


def test_children_end_with_a_parent_that_is_killed():
    endpoint = free_endpoint()
    code = (
        "import os, time\n"
        "from services.cli.processes import Crew\n"
        "crew = Crew(environment=os.environ)\n"
        "crew.start('router', 'router')\n"
        "print(crew._children[0].process.pid, flush=True)\n"
        "time.sleep(60)\n"
    )
    parent = subprocess.Popen(
        [sys.executable, "-c", code], cwd=ROOT, env=environment(endpoint), stdout=subprocess.PIPE, text=True
    )
    with parent:
        assert parent.stdout is not None
        child = int(parent.stdout.readline())
        with open_session(WireSettings(connect=(endpoint,)), wait_s=20):
            pass
        parent.kill()
    deadline = time.monotonic() + 15
    while is_running(child):
        assert time.monotonic() < deadline, "the child outlived its parent"
        time.sleep(0.05)


def is_running(pid: int) -> bool:
    stat = Path(f"/proc/{pid}/stat")
    try:
        return stat.read_text().rpartition(")")[2].split()[0] != "Z"
    except FileNotFoundError:
        return False
