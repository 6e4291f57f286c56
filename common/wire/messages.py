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
from common.wire.array import Array, Data
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

    state: Digest | None = Field(default=None, description="The state's digest.")
    content: StateMessage | None = Field(default=None, description="The state itself, where the worker lacks it.")
    actions: Array = Field(
        description="Actions (B, n); for plating the item's centre (x, y) [m] for each, for plating_yaw also its "
        "yaw, counter-clockwise [rad]."
    )

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

    heights: Array = Field(description="Heightmaps (B, H, W) after each action [m].")
    warnings: tuple[str, ...] = Field(description="One for each action, empty: none.")
    model: str
    version: str
    instance: str
    compute_s: Seconds = Field(description="Time that the model took [s].")
    load: Count = Field(default=0, description="Requests that wait at this worker.")

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

    mean: Array = Field(description="Estimated deviation (B,), scaled to [0, 1].")
    upper: Array = Field(description="Upper bound of the deviation (B,), scaled to [0, 1].")
    familiar: Array = Field(description="Whether the input is like those that the MDE learned from (B,), bool.")
    reason: str = Field(default="", description="In what unfamiliar inputs differ from those that it learned from.")
    model: str = Field(description="The model whose deviation is estimated.")
    version: str
    instance: str
    compute_s: Seconds = Field(description="Time that the estimator took [s].")
    load: Count = Field(default=0, description="Requests that wait at this worker.")
    scale_m: Annotated[float, Field(gt=0)] | None = Field(
        default=None, description="The deviation that counts as 1 [m]; null: the MDE does not say."
    )

    weights: Digest | None = Field(default=None, description="SHA-256 of what the MDE learned; null: it does not say.")

    @classmethod
    def of(
        cls, estimates: Estimates, *, model: str, instance: str, compute_s: float, weights: str | None = None
    ) -> Self:
        """Return an estimator's answer as a message."""
        return cls(
            mean=Array.of(estimates.mean),
            upper=Array.of(estimates.upper),
            familiar=Array.of(estimates.familiar),
            reason=estimates.reason,
            scale_m=estimates.scale_m,
            model=model,
            version=estimates.version,
            instance=instance,
            compute_s=compute_s,
            weights=weights,
        )


class LoadRequest(Request):
    """Gives a worker other weights to answer with from now on: a card as JSON, and the tensors that it tells of."""

    card: Data = Field(description="card.json of the weights.")
    tensors: Data = Field(description="weights.safetensors.")


class LoadReply(Reply):
    """The worker answers with the new weights; every request is answered by one version, and says which."""

    model: str
    version: str = Field(description="Version from now on.")
    previous: str = Field(description="Version until now.")
    weights: Digest = Field(description="SHA-256 of the weights.")
    instance: str


class Cost(Reply):
    """Median time of the last computations of one batch size."""

    batch: int = Field(ge=1, description="Number of actions.")
    p50_s: Seconds = Field(description="Median [s].")
    count: Count = Field(description="Number of computations that it is the median of.")


class Card(Reply):
    """Who a worker is."""

    task: Name
    role: Role
    model: Name | None = Field(description="The model that it runs or whose deviation it estimates, else null.")
    instance: Name
    version: str = Field(description="The model's version.")
    weights: Digest | None = Field(default=None, description="SHA-256 of what it learned.")
    device: str = Field(default="cpu", description="What it computes on.")
    grid: GridMessage | None = Field(default=None, description="The only grid that it takes, null: any.")
    largest_batch: int = Field(default=1, ge=1, description="Most actions in one request.")
    parameters: tuple[str, ...] = Field(
        default=(), description="Names of the action's parameters, in order, x and y [m] and yaw [rad]; empty: unknown."
    )
    protocol: int = VERSION
    cost: tuple[Cost, ...] = ()


class Health(Reply):
    """How a worker is doing."""

    status: Literal["ok", "stopping"]
    queue_length: Count = Field(description="Requests that wait.")
    in_progress: Count = Field(description="Requests that are computed now.")
    computing_s: Seconds | None = Field(description="Age of the oldest unfinished computation [s], null if idle.")
    served: Count = Field(description="Requests answered with a reply.")
    failed: Count = Field(description="Requests answered with an error by the model's fault.")
    refused: Count = Field(description="Requests answered with another error, puts that were refused included.")
    uptime_s: Seconds = Field(description="Since it began to serve [s].")
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
