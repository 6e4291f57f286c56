"""Messages between processes. SI units; times are durations in seconds; requests refuse fields they do not know."""

import uuid
from collections.abc import Mapping
from typing import Annotated, Literal, Self

import numpy as np
from numpy.typing import NDArray
from pydantic import BaseModel, ConfigDict, Field, model_validator

from common.domain.deviation import Estimates
from common.domain.errors import ERRORS, FrugalError
from common.domain.model import Event, Predictions
from common.domain.scene import State
from common.domain.trial import Result, Trial
from common.wire.array import Array
from common.wire.keys import NAME_PATTERN, VERSION, Role
from common.wire.state import GridMessage, StateMessage

Name = Annotated[str, Field(pattern=NAME_PATTERN)]
Digest = Annotated[str, Field(pattern=r"^[0-9a-f]{64}$")]
Seconds = Annotated[float, Field(ge=0)]
Count = Annotated[int, Field(ge=0)]


def new_id() -> str:
    """Return an identifier that nobody else has."""
    return uuid.uuid4().hex


class Request(BaseModel):
    """What a client sends. Numbers are finite, unknown fields are refused."""

    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False)

    id: Name = Field(default_factory=new_id)


class Reply(BaseModel):
    """What a worker sends. Unknown fields are ignored, so that newer workers can say more."""

    model_config = ConfigDict(frozen=True, extra="ignore", allow_inf_nan=False)


class StateRequest(Request):
    """A request about one state, named by its digest; the state itself travels only when the worker lacks it."""

    state: Digest | None = None
    content: StateMessage | None = None
    actions: Array

    @model_validator(mode="after")
    def _names_a_state(self) -> Self:
        if self.state is None and self.content is None:
            raise ValueError("expected the digest in 'state', the state in 'content', or both, got neither")
        return self

    @classmethod
    def of(cls, state: State, actions: NDArray[np.float64], *, content: bool) -> Self:
        """Return the request for actions ``(B, n)`` [m], with the state itself if ``content``."""
        message = StateMessage.of(state) if content else None
        return cls(state=state.digest, content=message, actions=Array.of(actions))

    def carrying(self, state: State) -> Self:
        """Return the same request with the state itself."""
        return self.model_copy(update={"content": StateMessage.of(state)})


class PredictRequest(StateRequest):
    """Asks a model for the outcomes of actions ``(B, n)`` [m] in one state."""


class EstimateRequest(StateRequest):
    """Asks an MDE for the deviations of its model for actions ``(B, n)`` [m] in one state."""


class PredictReply(Reply):
    """The outcomes ``(B, H, W)`` [m], a warning for each (empty: none), and the time that they took."""

    heights: Array
    warnings: tuple[str, ...]
    model: str
    version: str
    instance: str
    compute_s: Seconds
    load: Count = 0

    @classmethod
    def of(cls, predictions: Predictions, *, instance: str, compute_s: float) -> Self:
        """Return a model's answer as a message."""
        return cls(
            heights=Array.of(predictions.heights),
            warnings=predictions.warnings,
            model=predictions.model,
            version=predictions.version,
            instance=instance,
            compute_s=compute_s,
        )


class EstimateReply(Reply):
    """Estimated deviations ``(B,)``, their upper bounds, whether the MDE knows such inputs, and the time it took."""

    mean: Array
    upper: Array
    familiar: Array
    model: str
    version: str
    instance: str
    compute_s: Seconds
    load: Count = 0

    @classmethod
    def of(cls, estimates: Estimates, *, model: str, version: str, instance: str, compute_s: float) -> Self:
        """Return an estimator's answer as a message."""
        return cls(
            mean=Array.of(estimates.mean),
            upper=Array.of(estimates.upper),
            familiar=Array.of(estimates.familiar),
            model=model,
            version=version,
            instance=instance,
            compute_s=compute_s,
        )


class Cost(Reply):
    """Median time of the last computations of one batch size."""

    batch: Annotated[int, Field(ge=1)]
    p50_s: Seconds
    count: Count


class Card(Reply):
    """Who a worker is. ``weights`` is the SHA-256 of what it learned; ``grid`` the only one it takes, None: any."""

    task: Name
    role: Role
    model: Name | None
    instance: Name
    version: str
    weights: Digest | None = None
    device: str = "cpu"
    grid: GridMessage | None = None
    largest_batch: Annotated[int, Field(ge=1)] = 1
    protocol: int = VERSION
    cost: tuple[Cost, ...] = ()


class Health(Reply):
    """How a worker is doing; ``computing_s`` is the age of its oldest unfinished computation, None if idle."""

    status: Literal["ok", "stopping"]
    queue_length: Count
    in_progress: Count
    computing_s: Seconds | None
    served: Count
    failed: Count
    refused: Count
    uptime_s: Seconds
    cost: tuple[Cost, ...] = ()


class CancelReply(Reply):
    """Whether the request was there to be cancelled."""

    id: str
    found: bool


class ErrorReply(Reply):
    """Why there is no answer. The code says whose fault it was: `common.domain.errors`."""

    code: str
    message: str

    @classmethod
    def of(cls, error: FrugalError) -> Self:
        """Return an error as a message."""
        return cls(code=error.code, message=str(error))

    def error(self) -> FrugalError:
        """Return the error that the sender raised; an unknown code gives the root class."""
        return ERRORS.get(self.code, FrugalError)(self.message)


class EventMessage(Reply):
    """Something that went wrong and was dealt with, or a worker that came or left."""

    kind: str
    worker: str
    detail: str
    time: float

    @classmethod
    def of(cls, event: Event) -> Self:
        """Return an event as a message."""
        return cls(kind=event.kind, worker=event.worker, detail=event.detail, time=event.time)

    def event(self) -> Event:
        """Return the event."""
        return Event(self.kind, self.worker, self.detail, self.time)


class TrialMessage(Reply):
    """One evaluated action, as in `common.domain.trial.Trial`."""

    index: Count
    action: tuple[float, ...]
    model: str
    instance: str
    version: str
    reward: float | None
    estimates: dict[str, float] = {}
    warning: str = ""
    started_s: float = 0.0
    predict_s: float = 0.0
    compute_s: float = 0.0
    error: str = ""

    @classmethod
    def of(cls, trial: Trial) -> Self:
        """Return a trial as a message."""
        return cls(**vars(trial))

    def trial(self) -> Trial:
        """Return the trial."""
        return Trial(**dict(self))


class OptimizeRequest(Request):
    """Asks an orchestrator for the best action: the one whose outcome is nearest to the target.

    ``bounds`` holds smallest and largest value of each action parameter [m], the task's own if None; ``d_max`` is the
    largest deviation at which a fast model is trusted, scaled to [0, 1]; ``deadline_s`` ends the search early.
    """

    task: Name = "plating"
    state: StateMessage
    target: Array
    bounds: Annotated[tuple[tuple[float, float], ...], Field(min_length=1, max_length=16)] | None = None
    strategy: Annotated[str, Field(min_length=1, max_length=100)] = "threshold"
    evaluations: Annotated[int, Field(ge=1, le=5000)] = 50
    in_flight: Annotated[int, Field(ge=1, le=64)] = 1
    seed: Annotated[int, Field(ge=0, lt=2**63)] = 0
    d_max: Annotated[float, Field(gt=0, le=1)] = 0.4
    deadline_s: Annotated[float, Field(gt=0)] | None = None
    trusted: Name | None = None

    @model_validator(mode="after")
    def _bounds_are_open(self) -> Self:
        for index, (low, high) in enumerate(self.bounds or ()):
            if not low < high:
                raise ValueError(f"bounds: expected low < high for parameter {index}, got {low:g} and {high:g}")
        return self


class OptimizeReply(Reply):
    """The best action and its evidence, as in `common.domain.trial.Result`."""

    id: str
    task: str
    action: tuple[float, ...]
    reward: float
    heights: Array
    trials: tuple[TrialMessage, ...]
    usage: dict[str, int]
    models: dict[str, str]
    split_s: dict[str, float]
    wall_s: float
    events: tuple[EventMessage, ...]
    strategy: str
    seed: int
    instance: str

    @classmethod
    def of(cls, result: Result, *, request_id: str, task: str, instance: str) -> Self:
        """Return a result as a message."""
        fields = vars(result) | {
            "heights": Array.of(result.heights),
            "trials": tuple(TrialMessage.of(trial) for trial in result.trials),
            "events": tuple(EventMessage.of(event) for event in result.events),
        }
        return cls(id=request_id, task=task, instance=instance, **fields)

    def result(self) -> Result:
        """Return the result."""
        fields = dict(self) | {
            "heights": np.asarray(self.heights.values(), dtype=np.float32),
            "trials": tuple(trial.trial() for trial in self.trials),
            "events": tuple(event.event() for event in self.events),
        }
        return Result(**{name: fields[name] for name in Result.__dataclass_fields__})


class Progress(Reply):
    """One step of a running optimisation. The host fills in ``id`` and ``index``, which counts from 0 without gaps.

    ``accepted`` comes first and carries ``evaluations``; ``trial`` and ``event`` carry theirs; the last is ``finished``
    with action and reward, or ``failed`` with the error.
    """

    kind: Literal["accepted", "trial", "event", "finished", "failed"]
    id: str = ""
    index: Count = 0
    time: Seconds = 0.0
    strategy: str | None = None
    evaluations: int | None = None
    trial: TrialMessage | None = None
    event: EventMessage | None = None
    action: tuple[float, ...] | None = None
    reward: float | None = None
    error: ErrorReply | None = None


MESSAGES: Mapping[str, type[BaseModel]] = {
    message.__name__: message
    for message in (
        PredictRequest,
        PredictReply,
        EstimateRequest,
        EstimateReply,
        OptimizeRequest,
        OptimizeReply,
        Progress,
        Card,
        Health,
        CancelReply,
        ErrorReply,
    )
}
"""Name in the encoding -> message, for all that travel as a payload of their own."""
