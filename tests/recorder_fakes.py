"""Reports of executed actions, and the recorder that tests send them to."""

import time
from pathlib import Path

import numpy as np

from common.wire.array import Array
from common.wire.client import list_workers
from common.wire.examples import example_report
from common.wire.keys import Address
from common.wire.messages import Health
from common.wire.report import TrialReport
from common.wire.session import Session

START_S = 60.0
ADDRESS = Address("plating", "recorder", None, "r")


def a_report(number: int, **changes: object) -> TrialReport:
    """Return a report whose content and id follow from a number."""
    report = example_report()
    lift = np.float32(1e-5 * number)
    scene = report.state.scene.model_copy(update={"heights": Array.of(report.state.scene.heights.values() + lift)})
    content = {
        "id": f"trial-{number}",
        "robot": None,
        "state": report.state.model_copy(update={"scene": scene}),
        "outcome": Array.of(report.outcome.values() + lift),
    }
    return report.model_copy(update=content | changes)


def wait_for_recorder(session: Session, log: Path) -> Health:
    deadline = time.monotonic() + START_S
    while time.monotonic() < deadline:
        for status in list_workers(session):
            if status.address == ADDRESS and status.health is not None:
                return status.health
        time.sleep(0.05)
    raise AssertionError(log.read_text())
