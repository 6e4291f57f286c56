"""Messages of an optimisation: the request, its answer, and the steps on the way."""

import hashlib
from collections.abc import Callable
from typing import Annotated, Literal, Self

import numpy as np
from pydantic import BaseModel, Field, model_validator

from common.domain.certificate import Certificate
from common.domain.model import Event
from common.domain.trial import Result, Trial
from common.wire.array import Array
from common.wire.messages import Count, ErrorReply, Name, Reply, Request, Seconds
from common.wire.state import StateMessage


class EventMessage(Reply):
    """Something that went wrong and was dealt with, or a worker that came or left."""

    kind: str
    worker: str = Field(description="<model>/<instance>, mde/<model>/<instance>, else <role>/<instance>.")
    detail: str
    time: float = Field(description="Since the optimisation, or the call, began [s].")

    @classmethod
    def of(cls, event: Event) -> Self:
        """Return an event as a message."""
        return cls(kind=event.kind, worker=event.worker, detail=event.detail, time=event.time)

    def event(self) -> Event:
        """Return the event."""
        return Event(self.kind, self.worker, self.detail, self.time)


class TrialMessage(Reply):
    """One evaluated action, as in `common.domain.trial.Trial`."""

    index: Count = Field(description="Order of asking, from 0.")
    action: tuple[float, ...] = Field(description="The action's parameters [m].")
    model: str = Field(description="The model that predicted its outcome.")
    instance: str = Field(description="The worker that answered.")
    version: str = Field(description="The model's version.")
    reward: float | None = Field(
        description="Minus the mean absolute height difference to the target [m]; null: no model could predict it."
    )
    estimates: dict[str, float] = Field(default={}, description="Estimated deviation by model, scaled to [0, 1].")
    warning: str = Field(default="", description="What the model said about this outcome, empty if nothing.")
    started_s: float = Field(default=0.0, description="When it was dispatched, since the optimisation began [s].")
    predict_s: float = Field(default=0.0, description="From dispatch to answer [s].")
    compute_s: float = Field(default=0.0, description="The part of it that the model took [s].")
    error: str = Field(default="", description="Why there is no reward, empty if there is one.")
    uppers: dict[str, float] = Field(default={}, description="Upper bound of the estimated deviation by model.")
    unfamiliar: tuple[str, ...] = Field(default=(), description="Models whose MDE does not know such inputs.")
    mdes: dict[str, str] = Field(default={}, description="Version of the MDE that estimated, by model.")

    @classmethod
    def of(cls, trial: Trial) -> Self:
        """Return a trial as a message."""
        return cls(**vars(trial))

    def trial(self) -> Trial:
        """Return the trial."""
        return Trial(**dict(self))


class OptimizeRequest(Request):
    """Asks an orchestrator for the best action: the one whose outcome is nearest to the target."""

    task: Name = Field(default="plating", description="The task that the orchestrator has to serve.")
    state: StateMessage
    target: Array = Field(description="Heightmap (H, W) that the outcome should have, on the state's grid [m].")
    bounds: Annotated[tuple[tuple[float, float], ...], Field(min_length=1, max_length=16)] | None = Field(
        default=None,
        description="Smallest and largest value of each action parameter [m], within the task's; null: those.",
    )
    strategy: str = Field(
        default="quality",
        min_length=1,
        max_length=100,
        description="Which actions are evaluated, and by which model: quality, balanced and fast (at most 12, 4 and 2 "
        "calls of the trusted model, led by the cheap ones), transport:calls=<number> and residual:calls=<number> (any "
        "budget), threshold (the paper's: each action by the cheapest model whose MDE knows such inputs and estimates "
        "a deviation below d_max, else by the trusted one), threshold:upper (the same by the estimate's upper bound), "
        "random, or only:<model>.",
    )
    evaluations: int = Field(
        default=50, ge=1, le=5000, description="How many actions to evaluate; strategies with a budget stop at theirs."
    )
    in_flight: Annotated[int, Field(ge=1, le=64)] | None = Field(
        default=None,
        description="How many evaluations run at the same time; null: as many as there are live replicas of the "
        "trusted model, or of the one that the strategy names. The reply says how many it was.",
    )
    seed: int = Field(default=0, ge=0, lt=2**63, description="Seed of every random choice.")
    d_max: float = Field(
        default=0.4, gt=0, le=1, description="Estimated deviation, scaled to [0, 1], below which a model is used."
    )
    deadline_s: float | None = Field(
        default=None, gt=0, description="When to answer with the best action known, since the request arrived [s]."
    )
    trusted: Name | None = Field(default=None, description="The model that is always applicable; null: the task's.")

    @model_validator(mode="after")
    def _bounds_are_open(self) -> Self:
        for index, (low, high) in enumerate(self.bounds or ()):
            if not low < high:
                raise ValueError(f"bounds: expected low < high for parameter {index}, got {low:g} and {high:g}")
        return self

    def identity(self) -> tuple[str, str]:
        """Return what makes another request the same one: the id, and the SHA-256 in hex of all fields."""
        digest = hashlib.sha256()
        _feed(digest.update, self)
        return self.id, digest.hexdigest()

    def question(self) -> str:
        """Return what makes another request ask for the same: the SHA-256 in hex of all fields but the id."""
        return self.model_copy(update={"id": ""}).identity()[1]


def _feed(update: Callable[[bytes], None], value: object) -> None:
    """Hash a value without copying its arrays; every part says its kind and length, so that none runs into the next."""
    if isinstance(value, bytes):
        update(b"bytes %d;" % len(value))
        update(value)
    elif isinstance(value, BaseModel):
        for _, part in value:
            _feed(update, part)
    elif isinstance(value, tuple):
        update(b"tuple %d;" % len(value))
        for part in value:
            _feed(update, part)
    else:
        update(f"{value!r};".encode())


class CertificateMessage(Reply):
    """No action on a grid is better than the answer by more than ``gain``, see `common.domain.certificate`."""

    gain: float = Field(ge=0, description="Largest gain in reward that any action on the grid may bring [m].")
    probability: float = Field(gt=0, lt=1, description="Share of optimisations for which that is true.")
    actions: int = Field(ge=1, description="Number of actions on the grid.")
    left: float = Field(ge=0, le=1, description="Share of them that may be better than the answer.")

    @classmethod
    def of(cls, certificate: Certificate) -> Self:
        """Return a certificate as a message."""
        return cls(**vars(certificate))

    def certificate(self) -> Certificate:
        """Return the certificate."""
        return Certificate(**dict(self))


class OptimizeReply(Reply):
    """The best action and its evidence, as in `common.domain.trial.Result`."""

    id: str
    task: str
    action: tuple[float, ...] = Field(description="The best action's parameters [m].")
    reward: float = Field(
        description="Predicted reward of that action: minus the mean absolute height difference to the target [m]."
    )
    heights: Array = Field(description="Predicted heightmap (H, W) after that action [m].")
    trials: tuple[TrialMessage, ...] = Field(description="Every evaluated action, in the order of asking.")
    usage: dict[str, int] = Field(
        description="Number of evaluated actions by model: trials, and what strategies asked cheap models in sweeps."
    )
    models: dict[str, str] = Field(
        description="Version of every model that was used, and of every MDE as mde/<model>; commas between several."
    )
    split_s: dict[str, float] = Field(description="Time by model, and for mde, optimiser and transport [s].")
    wall_s: float = Field(description="Duration of the whole optimisation [s].")
    events: tuple[EventMessage, ...] = Field(description="What went wrong and was dealt with, and who came or left.")
    strategy: str
    seed: int
    instance: str = Field(description="The orchestrator that answered.")
    in_flight: int = Field(default=1, ge=1, description="How many evaluations ran at the same time.")
    certificate: CertificateMessage | None = Field(
        default=None, description="How much better another action may be; null: the strategy cannot say."
    )

    @classmethod
    def of(cls, result: Result, *, request_id: str, task: str, instance: str) -> Self:
        """Return a result as a message."""
        fields = vars(result) | {
            "heights": Array.of(result.heights),
            "trials": tuple(TrialMessage.of(trial) for trial in result.trials),
            "events": tuple(EventMessage.of(event) for event in result.events),
            "certificate": result.certificate and CertificateMessage.of(result.certificate),
        }
        return cls(id=request_id, task=task, instance=instance, **fields)

    def result(self) -> Result:
        """Return the result."""
        fields = dict(self) | {
            "heights": np.asarray(self.heights.values(), dtype=np.float32),
            "trials": tuple(trial.trial() for trial in self.trials),
            "events": tuple(event.event() for event in self.events),
            "certificate": self.certificate and self.certificate.certificate(),
        }
        return Result(**{name: fields[name] for name in Result.__dataclass_fields__})


class Progress(Reply):
    """One step of a running optimisation. The host fills in ``id``, ``run`` and ``index``, from 0 without gaps.

    ``accepted`` comes first and carries ``evaluations``; ``trial`` and ``event`` carry theirs; the last is ``finished``
    with action and reward, or ``failed`` with the error.
    """

    kind: Literal["accepted", "trial", "event", "finished", "failed"]
    id: str = ""
    run: str = Field(default="", description="Another one if the request, sent again, is begun or resumed once more.")
    index: Count = 0
    time: Seconds = Field(default=0.0, description="Since the optimisation began [s].")
    strategy: str | None = None
    evaluations: int | None = None
    trial: TrialMessage | None = None
    event: EventMessage | None = None
    action: tuple[float, ...] | None = None
    reward: float | None = None
    error: ErrorReply | None = None
