"""`deploy/zenoh/router.json5` makes the same router as `frugal serve router`."""

import json
from pathlib import Path

import pytest
import zenoh

from common.wire.session import configuration
from common.wire.settings import WireSettings

FILE = Path(__file__).parents[2] / "deploy" / "zenoh" / "router.json5"


@pytest.mark.parametrize(
    "key",
    [
        "mode",
        "scouting/multicast/enabled",
        "scouting/gossip/enabled",
        "timestamping/enabled",
        "transport/link/tx/lease",
        "transport/shared_memory/enabled",
    ],
)
def test_the_configuration_file_agrees_with_the_router_of_the_command_line(key: str) -> None:
    ours = configuration("router", WireSettings())
    assert json.loads(zenoh.Config.from_file(FILE).get_json(key)) == json.loads(ours.get_json(key))


def test_a_zenoh_router_starts_from_the_configuration_file() -> None:
    config = zenoh.Config.from_file(FILE)
    config.insert_json5("listen/endpoints", '["tcp/127.0.0.1:0"]')
    with zenoh.open(config) as session:
        assert not session.is_closed()
