"""The orchestrator: answers ``optimize`` queries by running the loop over whoever is alive."""

import logging
import math
import queue
import threading
import time
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import TypeVar

import numpy as np
from pydantic import Field
from pydantic_settings import BaseSettings, SettingsConfigDict

from common.domain.errors import FrugalError, RequestError, UnavailableError
from common.domain.model import Event
from common.domain.task import Task
from common.domain.trial import Result, Trial
from common.planning.evaluation import elapsed_s
from common.planning.optimize import MOST_IN_FLIGHT, optimize
from common.planning.problem import Problem
from common.planning.selection import parse_strategy
from common.storage.journal import Journal, open_journal
from common.wire.call import Call
from common.wire.directory import Directory
from common.wire.dispatch import Limits
from common.wire.endpoint import Alias, Endpoint
from common.wire.host import Host
from common.wire.keys import Role, alias
from common.wire.messages import Card
from common.wire.optimization import EventMessage, OptimizeReply, OptimizeRequest, Progress, TrialMessage
from common.wire.remote import RemoteEstimator, RemoteModel
from common.wire.run import run_host
from common.wire.session import Session
from common.wire.settings import WireSettings

Remote = TypeVar("Remote", RemoteModel, RemoteEstimator)

log = logging.getLogger(__name__)

VERSION = "1"
ANSWER_MARGIN_S = 0.2
"""Kept back of a caller's budget, so that the answer is there in time [s]."""


class OrchestratorSettings(BaseSettings):
    """Settings of the orchestrator, from ``FRUGAL_ORCHESTRATOR_...`` environment variables.

    Attributes:
        requests: Optimisations at the same time; further ones wait.
        queue_length: Optimisations that may wait; further ones are answered ``busy``.
        predict_timeout_s: Longest time for one prediction [s].
        estimate_timeout_s: Longest time for one estimate [s].
        patience_s: How long to wait for a missing model before saying so [s].
        journal: Folder where optimisations are kept until they are answered, so that the same request resumes one that
            was interrupted; None or empty: nothing is kept.
    """

    model_config = SettingsConfigDict(env_prefix="FRUGAL_ORCHESTRATOR_", frozen=True, env_ignore_empty=True)

    requests: int = Field(default=4, ge=1, le=64)
    queue_length: int = Field(default=16, ge=1, le=1024)
    predict_timeout_s: float = Field(default=30.0, gt=0)
    estimate_timeout_s: float = Field(default=5.0, gt=0)
    patience_s: float = Field(default=1.0, ge=0, le=60)
    journal: Path | None = None


@dataclass(frozen=True)
class Assignment:
    """A request that was found to be right, and what it means."""

    request: OptimizeRequest
    problem: Problem


class Orchestrator:
    """Runs optimisations of one task over the workers of a directory; safe to call from several threads."""

    def __init__(self, task: Task, directory: Directory, settings: OrchestratorSettings, *, instance: str) -> None:
        self._task = task
        self._directory = directory
        self._settings = settings
        self._instance = instance
        self._listeners: set[queue.SimpleQueue[Event]] = set()
        directory.on_change(self._spread)

    def endpoint(self) -> Endpoint:
        """Return the endpoint ``optimize``; on the alias of a task that nobody serves it says which one it serves."""
        return Endpoint(
            leaf="optimize",
            request=OptimizeRequest,
            handler=self.handle,
            prepare=self.prepare,
            identity=OptimizeRequest.identity,
            aliases=(Alias(alias(self._task.name, "optimize")), Alias(alias("*", "optimize"), complete=False)),
            unique_ids=True,
        )

    def prepare(self, request: OptimizeRequest) -> Assignment:
        """Return what a request asks for.

        Raises:
            RequestError: It names another task or an unknown strategy, or state, target and bounds do not fit together.
        """
        if request.task != self._task.name:
            raise RequestError(f"task: expected {self._task.name}, got {request.task!r}")
        parse_strategy(request.strategy)
        bounds = None if request.bounds is None else np.array(request.bounds)
        return Assignment(request, Problem(self._task, request.state.state(), request.target.values(), bounds))

    def handle(self, assignment: Assignment, call: Call) -> OptimizeReply:
        """Run one optimisation, publishing its steps.

        Raises:
            UnavailableError: A model that the strategy needs has no live worker.
            CancelledError: The caller took the request back.
            TimedOutError: The budget ended before the first answer.
        """
        with open_journal(self._settings.journal, assignment.request.question()) as journal:
            return self._answer(assignment, call, journal)

    def _answer(self, assignment: Assignment, call: Call, journal: Journal) -> OptimizeReply:
        began, request = time.monotonic() - elapsed_s(journal.evaluations), assignment.request
        news: queue.SimpleQueue[Event] = queue.SimpleQueue()
        seen: list[Event] = []

        def publish(**fields: object) -> None:
            call.publish(Progress.model_validate({"time": time.monotonic() - began, **fields}))

        def interrupted() -> bool:
            while not news.empty():
                event = replace(news.get(), time=time.monotonic() - began)
                seen.append(event)
                publish(kind="event", event=EventMessage.of(event))
            return call.cancelled()

        def on_trial(trial: Trial) -> None:
            publish(kind="trial", trial=TrialMessage.of(trial))

        budget = parse_strategy(request.strategy).budget(request.evaluations)
        publish(kind="accepted", strategy=request.strategy, evaluations=budget)
        for event in (*self._resumed(journal), *self._left_out(assignment.problem)):
            news.put(event)
        self._listeners.add(news)
        try:
            result = self._run(assignment, call, journal, on_trial=on_trial, interrupted=interrupted)
        finally:
            self._listeners.discard(news)
        result = replace(result, events=tuple(sorted((*result.events, *seen), key=lambda event: event.time)))
        publish(kind="finished", action=result.action, reward=result.reward)
        return OptimizeReply.of(result, request_id=request.id, task=self._task.name, instance=self._instance)

    def _run(
        self,
        assignment: Assignment,
        call: Call,
        journal: Journal,
        *,
        on_trial: Callable[[Trial], None],
        interrupted: Callable[[], bool],
    ) -> Result:
        request, problem = assignment.request, assignment.problem
        trusted = request.trusted or self._task.trusted
        required = parse_strategy(request.strategy).required(trusted)
        deadline_s = _deadline_s(request, call)
        patience_s = self._settings.patience_s if deadline_s is None else min(self._settings.patience_s, deadline_s)
        self._directory.wait_for("model", required, timeout_s=patience_s)
        deadline_s = _deadline_s(request, call)  # again: it may have waited
        until = time.monotonic() + (math.inf if deadline_s is None else deadline_s + ANSWER_MARGIN_S / 2)
        finished = threading.Event()
        limits = Limits(
            timeout_s=self._settings.predict_timeout_s,
            remaining=lambda: until - time.monotonic(),
            cancelled=lambda: call.cancelled() or finished.is_set(),
        )
        quick = replace(limits, timeout_s=self._settings.estimate_timeout_s)
        models = self._models(problem, limits, journal, trusted=trusted)
        if required not in models:
            raise self._refusal(required, problem)
        estimators = self._estimators(problem, quick, journal)
        in_flight = request.in_flight or self._replicas(required, problem)
        course = journal.begin(models=tuple(models), estimators=tuple(estimators), in_flight=in_flight)
        try:
            return optimize(
                problem,
                models,
                estimators,
                strategy=request.strategy,
                d_max=request.d_max,
                evaluations=request.evaluations,
                in_flight=course.in_flight,
                seed=request.seed,
                trusted=trusted,
                deadline_s=deadline_s,
                on_trial=on_trial,
                cancelled=interrupted,
                earlier=journal.evaluations,
                on_evaluation=journal.append,
            )
        finally:
            finished.set()

    def _replicas(self, model: str, problem: Problem) -> int:
        """Return how many live workers of a model take the problem's grid and have not failed lately, 1 at least."""
        found = [
            worker
            for worker in self._directory.workers("model", model)
            if worker.card is not None
            and not worker.is_suspect
            and (worker.card.grid is None or worker.card.grid.grid() == problem.state.grid)
        ]
        return min(max(len(found), 1), MOST_IN_FLIGHT)

    def _refusal(self, model: str, problem: Problem) -> FrugalError:
        """Return why a model that was alive a moment ago cannot be used."""
        live = [worker.card for worker in self._directory.workers("model", model) if worker.card is not None]
        if live:
            grids = ", ".join(str(card.grid and card.grid.grid()) for card in live)
            return RequestError(f"grid: expected one that {model} takes ({grids}), got {problem.state.grid}")
        return UnavailableError(f"expected a live worker for model {model} of {self._task.name}, got none")

    def _models(self, problem: Problem, limits: Limits, journal: Journal, *, trusted: str) -> Mapping[str, RemoteModel]:
        """Return the models that take the problem's grid, from cheapest to dearest by measured cost.

        A run that is resumed gets those that it had, in the same order.
        """
        known = None if journal.course is None else journal.course.models
        names = self._fitting("model", problem, known=known)
        if known is None:
            ordered = by_cost({name: self._directory.action_s("model", name) for name in names}, trusted=trusted)
        else:
            ordered = [name for name in known if name in names]
        return _reachable(ordered, partial(RemoteModel, self._directory, limits=limits))

    def _estimators(self, problem: Problem, limits: Limits, journal: Journal) -> Mapping[str, RemoteEstimator]:
        known = None if journal.course is None else journal.course.estimators
        names = sorted(self._fitting("mde", problem, known=known))
        return _reachable(names, partial(RemoteEstimator, self._directory, limits=limits))

    def _resumed(self, journal: Journal) -> list[Event]:
        """Return an event if an interrupted run has left something."""
        if journal.course is None:
            return []
        count, seconds = len(journal.evaluations), elapsed_s(journal.evaluations)
        detail = f"{count} evaluations of the {seconds:.3g} s before an interruption are known"
        return [Event("resumed", f"orchestrator/{self._instance}", detail)]

    def _left_out(self, problem: Problem) -> list[Event]:
        """Return an event for every live model or MDE that does not take the problem's grid."""
        return [
            Event("left_out", worker.address.worker, f"expected {worker.card.grid.grid()}, got {problem.state.grid}")
            for worker in self._directory.workers()
            if worker.address.role in ("model", "mde")
            and worker.card is not None
            and worker.card.grid is not None
            and worker.card.grid.grid() != problem.state.grid
        ]

    def _fitting(self, role: Role, problem: Problem, *, known: Sequence[str] | None) -> set[str]:
        """Return the models that take the problem's grid, or that have an MDE that does; of known ones those alone."""
        for name in known or ():
            with suppress(UnavailableError):  # they were there; a new process does not see everybody at once
                self._directory.wait_for(role, name, timeout_s=self._settings.patience_s)
        fitting = {
            worker.address.model
            for worker in self._directory.workers()
            if worker.address.role == role
            and worker.address.model is not None
            and worker.card is not None
            and (worker.card.grid is None or worker.card.grid.grid() == problem.state.grid)
        }
        return fitting if known is None else fitting & set(known)

    def _spread(self, event: Event) -> None:
        for listener in tuple(self._listeners):
            listener.put(event)


def run_orchestrator(settings: WireSettings, own: OrchestratorSettings, *, task: Task, instance: str) -> int:
    """Serve ``optimize`` until SIGTERM or SIGINT and return the process's exit code."""
    log.info("settings: %s", own.model_dump_json())

    def build(session: Session) -> Host:
        orchestrator = Orchestrator(task, Directory(session, task=task.name), own, instance=instance)
        card = Card(
            task=task.name,
            role="orchestrator",
            model=None,
            instance=instance,
            version=VERSION,
            parameters=task.names,
        )
        endpoints = [orchestrator.endpoint()]
        return Host(session, card, endpoints, threads=own.requests, queue_length=own.queue_length)

    return run_host(build, settings)


def by_cost(costs: Mapping[str, float | None], *, trusted: str) -> list[str]:
    """Return models from cheapest to dearest; those whose cost nobody knows yet come just before the trusted one.

    Behind it they would never be asked, and so never be measured.
    """
    known = {name: math.inf if cost is None else cost for name, cost in costs.items()}
    limit = known.get(trusted, math.inf)

    def rank(name: str) -> tuple[float, bool, str]:
        if costs[name] is None and name != trusted:
            return limit, False, name
        return known[name], True, name

    return sorted(costs, key=rank)


def _deadline_s(request: OptimizeRequest, call: Call) -> float | None:
    """Return how long from now it may take to answer, by the request and by the caller's budget [s]."""
    wanted_s = math.inf if request.deadline_s is None else request.deadline_s - (time.monotonic() - call.began)
    deadline_s = min(wanted_s, call.remaining() - ANSWER_MARGIN_S)
    return None if math.isinf(deadline_s) else max(deadline_s, 1e-3)


def _reachable(names: Sequence[str], make: Callable[[str], Remote]) -> dict[str, Remote]:
    """Return what can be made of the names; one whose last worker has just gone is left out."""
    found: dict[str, Remote] = {}
    for name in names:
        try:
            found[name] = make(name)
        except UnavailableError:
            continue
    return found
