"""Messages between processes. SI units; times are durations in seconds; requests refuse fields they do not know."""

import uuid
from typing import Annotated, Literal, Self

import numpy as np
from numpy.typing import NDArray
from pydantic import BaseModel, ConfigDict, Field, model_validator

from common.domain.deviation import Estimates
from common.domain.errors import ERRORS, FrugalError
from common.domain.model import Predictions
from common.domain.scene import State
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
