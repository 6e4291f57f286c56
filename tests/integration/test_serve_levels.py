"""A level of the simulator joins the system as a model of its own."""

import os
import time

from common.wire.client import list_workers
from common.wire.session import open_session
from common.wire.settings import WireSettings
from services.cli.processes import Crew
from tests.fakes import free_endpoint

START_S = 60.0


def test_the_coarse_simulator_is_served_under_its_own_name_with_its_device():
    endpoint = free_endpoint()
    with Crew(environment=os.environ | {"FRUGAL_CONNECT": endpoint, "FRUGAL_LISTEN": endpoint}) as crew:
        crew.start("router", "router")
        crew.start("coarse", "simulator", "--level", "coarse", "--instance", "c")
        with open_session(WireSettings(connect=(endpoint,)), wait_s=20) as session:
            deadline = time.monotonic() + START_S
            while not (found := list_workers(session)):
                assert time.monotonic() < deadline, "no worker came up"
                time.sleep(0.1)
    (status,) = found
    assert status.address.worker == "simulator_coarse/c"
    assert status.card is not None
    assert (status.card.model, status.card.device) == ("simulator_coarse", "cpu")
