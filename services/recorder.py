"""The recorder: takes trials that robots report, and keeps those that can be true."""

import logging
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path

from common.domain.case import Case
from common.domain.errors import RequestError
from common.domain.executed import check_executed
from common.domain.grid import Grid
from common.domain.task import Task
from common.storage.trials import ExecutedTrial, TrialStore
from common.wire.call import Call
from common.wire.endpoint import Alias, Endpoint
from common.wire.host import Host
from common.wire.keys import TRIAL, alias, robot_of
from common.wire.messages import Card
from common.wire.report import TrialReply, TrialReport
from common.wire.run import run_host
from common.wire.session import Session
from common.wire.settings import WireSettings
from common.wire.state import GridMessage

log = logging.getLogger(__name__)

VERSION = "1"
QUEUE_LENGTH = 64
"""Trials that may wait for the disk; further ones are answered ``busy``."""


@dataclass(frozen=True)
class Recorder:
    """Checks and keeps the trials of one task."""

    task: Task
    store: TrialStore

    def endpoint(self) -> Endpoint:
        """Return the endpoint ``trial``, for queries and for puts; for another task's it says which one it serves."""
        everyone = f"{TRIAL}/*"
        return Endpoint(
            leaf=TRIAL,
            request=TrialReport,
            handler=self.handle,
            prepare=self.prepare,
            aliases=(Alias(alias(self.task.name, everyone)), Alias(alias("*", everyone), complete=False)),
            read_key=name_robot,
            takes_puts=True,
        )

    def prepare(self, report: TrialReport) -> ExecutedTrial:
        """Return the trial that is reported.

        Raises:
            RequestError: It cannot be true, see `common.domain.executed`, or nobody is named as its robot.
        """
        if report.robot is None:
            raise RequestError(f"robot: expected a name in the report or in the key, {TRIAL}/<robot>, got none")
        state = report.state.state()
        outcome = check_executed(self.task, state, report.action, report.outcome.values())
        case = Case(
            name=f"{report.robot}-{report.id}",
            seed=0,
            state=state,
            target=outcome,
            true_action=report.action,
            same_item=True,
            notes=report.notes,
            task=self.task.name,
        )
        return ExecutedTrial(robot=report.robot, id=report.id, case=case, received=datetime.now(UTC))

    def handle(self, trial: ExecutedTrial, call: Call) -> TrialReply:
        """Keep a trial and say where, once it is on disk; errors as in `TrialStore.append`."""
        kept = self.store.append(trial)
        log.info("%s: trial %d of %s", kept.file, kept.number, kept.robot)
        return TrialReply(
            id=kept.id, task=kept.task, robot=kept.robot, digest=kept.digest, number=kept.number, file=kept.file
        )


def name_robot(report: TrialReport, key: str) -> TrialReport:
    """Return the report with the robot that its key names.

    Raises:
        RequestError: The report names another one, or the key's last chunk is no name.
    """
    robot = robot_of(key)
    if robot is None:
        return report
    if report.robot not in (None, robot):
        raise RequestError(f"robot: expected {robot} as the key names it, got {report.robot}")
    return report.model_copy(update={"robot": robot})


def run_recorder(settings: WireSettings, *, task: Task, instance: str, folder: Path, grid: Grid | None) -> int:
    """Serve ``trial`` until SIGTERM or SIGINT and return the process's exit code.

    Raises:
        RequestError: The folder holds trials of another task or grid.
        UnavailableError: Another recorder writes to the folder, or the disk refuses it.
    """
    with TrialStore(folder, task=task.name, grid=grid) as store:
        log.info("%s: %d trials of %s", folder, len(store), task.name)

        def build(session: Session) -> Host:
            card = Card(
                task=task.name,
                role="recorder",
                model=None,
                instance=instance,
                version=VERSION,
                grid=store.grid and GridMessage.of(store.grid),
                parameters=task.names,
            )
            return Host(session, card, [Recorder(task, store).endpoint()], queue_length=QUEUE_LENGTH)

        return run_host(build, settings)
