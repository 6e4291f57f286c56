"""`deploy/zenoh/*.json5` make the same router as `frugal serve router`, one of them with access control."""

import json
from collections.abc import Iterator
from contextlib import ExitStack
from pathlib import Path

import numpy as np
import pytest
import zenoh

from common.wire.messages import EstimateReply, EstimateRequest, LoadReply, LoadRequest
from common.wire.query import NoReplyError, ask
from common.wire.serve import host_estimator
from common.wire.session import Session, configuration, open_session
from common.wire.settings import WireSettings
from tests.fakes import Radius, free_endpoint, make_state

FOLDER = Path(__file__).parents[2] / "deploy" / "zenoh"
FILES = ("router.json5", "access.json5")
WORKER = "frugal/@v1/plating/mde/tilted/a"
LOAD = LoadRequest(card=b"{}", tensors=b"")


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
@pytest.mark.parametrize("name", FILES)
def test_the_configuration_file_agrees_with_the_router_of_the_command_line(name: str, key: str) -> None:
    ours = configuration("router", WireSettings())
    assert json.loads(zenoh.Config.from_file(FOLDER / name).get_json(key)) == json.loads(ours.get_json(key))


@pytest.mark.parametrize("name", FILES)
def test_a_zenoh_router_starts_from_the_configuration_file(name: str) -> None:
    config = zenoh.Config.from_file(FOLDER / name)
    config.insert_json5("listen/endpoints", '["tcp/127.0.0.1:0"]')
    with zenoh.open(config) as session:
        assert not session.is_closed()


@pytest.fixture
def session(request: pytest.FixtureRequest) -> Iterator[Session]:
    """Return a session at a router with access control for an interface, with an MDE that takes weights over."""
    endpoint, text = free_endpoint(), (FOLDER / "access.json5").read_text()
    config = zenoh.Config.from_json5(text.replace('"eth0"', f'"{request.param}"'))
    config.insert_json5("listen/endpoints", json.dumps([endpoint]))
    with ExitStack() as stack:
        stack.enter_context(zenoh.open(config))
        worker, client = (
            stack.enter_context(open_session(WireSettings(connect=(endpoint,)), wait_s=20)) for _ in range(2)
        )
        host = host_estimator(
            worker, Radius(), task="plating", instance="a", load=lambda card, tensors: (Radius(), "0" * 64)
        )
        host.start()
        stack.callback(host.stop, grace_s=0)
        request_one = EstimateRequest.of(make_state(), np.zeros((1, 2)), content=True)
        assert ask(client, f"{WORKER}/estimate", request_one, EstimateReply, timeout_s=20).model == "tilted"
        yield client


@pytest.mark.parametrize("session", ["eth0"], indirect=True)
def test_who_comes_over_another_interface_may_load_weights(session: Session) -> None:
    assert ask(session, f"{WORKER}/load", LOAD, LoadReply, timeout_s=20).version == "1"


@pytest.mark.parametrize("session", ["lo"], indirect=True)
def test_who_comes_over_the_network_s_interface_may_not(session: Session) -> None:
    with pytest.raises(NoReplyError):
        ask(session, f"{WORKER}/load", LOAD, LoadReply, timeout_s=20)


@pytest.mark.parametrize("session", ["lo"], indirect=True)
@pytest.mark.parametrize("key", [f"{WORKER}/*", "frugal/@v1/**"])
def test_a_wildcard_does_not_go_round_the_rule(session: Session, key: str) -> None:
    replies: list[object] = []
    for reply in session.get(key, payload=LOAD.model_dump_json(), timeout=20.0, target=zenoh.QueryTarget.ALL):
        replies.append(reply.ok and str(reply.ok.key_expr))
    assert f"{WORKER}/load" not in replies
    assert f"{WORKER}/card" in replies
