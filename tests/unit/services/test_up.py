"""What `frugal up` starts, and where it keeps what has to survive."""

from collections import Counter
from pathlib import Path

import pytest

from services.cli.folders import state_folder, trials_folder
from services.cli.up import start_system


class Noted:
    """Stands where a crew would, and starts nothing."""

    def __init__(self) -> None:
        self.started: dict[str, tuple[str, ...]] = {}

    def start(self, name: str, *arguments: str) -> None:
        self.started[name] = arguments


@pytest.mark.parametrize("has_recorder", [True, False])
def test_a_recorder_is_started_and_waited_for_only_where_it_is_wanted(has_recorder: bool):
    crew = Noted()
    expected = start_system(crew, simulators=1, task="plating_yaw", has_recorder=has_recorder)
    assert expected["recorder"] == has_recorder
    commands = Counter(arguments[0] for arguments in crew.started.values())
    assert commands["recorder"] == has_recorder
    assert sum(expected.values()) + 1 == sum(commands.values())
    if has_recorder:
        assert crew.started["recorder"] == ("recorder", "--instance", "recorder-1", "--task", "plating_yaw")


def test_a_user_s_trials_are_kept_by_task_where_the_environment_says(monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setenv("XDG_STATE_HOME", "/there")
    assert trials_folder("plating") == Path("/there/frugal/trials/plating")
    monkeypatch.setenv("XDG_STATE_HOME", "")
    monkeypatch.setenv("HOME", "/home/somebody")
    assert state_folder() == Path("/home/somebody/.local/state/frugal")
