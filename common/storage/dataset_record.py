"""One state of a data set and the samples made in it: in memory, and the line that is kept of it beside the arrays."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from pydantic import BaseModel, ConfigDict

from common.domain.scene import State
from common.wire.state import BodiesMessage


@dataclass(frozen=True)
class StateSamples:
    """K actions tried in one state.

    Attributes:
        index: Number of the state in its split.
        seed: Seed of its generator.
        layout: How the fries lie.
        kind: The item's outline.
        places: What each action aimed at, K names.
        state: Scene and item; None if no scene came to rest.
        actions: ``(K, 2)`` [m].
        outcomes: ``(K, H, W)`` [m]; NaN where there is none.
        warnings: Per sample why it failed; empty if it came to rest.
        wall_s: Time of drawing the state, then of each sample [s].
        reason: Why there is no state.
    """

    index: int
    seed: tuple[int, ...]
    layout: str
    kind: str
    places: tuple[str, ...]
    state: State | None
    actions: NDArray[np.float64]
    outcomes: NDArray[np.float32]
    warnings: tuple[str, ...]
    wall_s: tuple[float, ...]
    reason: str = ""


class StateRecord(BaseModel):
    """A line of ``states.jsonl``: what of `StateSamples` is no array. It is written after the arrays."""

    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False)

    index: int
    seed: tuple[int, ...]
    layout: str
    kind: str
    rigid: bool
    digest: str
    places: tuple[str, ...]
    warnings: tuple[str, ...]
    reason: str
    bodies: BodiesMessage | None

    @classmethod
    def of(cls, made: StateSamples) -> "StateRecord":
        """Return the record of a state."""
        state = made.state
        bodies = None if state is None else state.scene.bodies
        return cls(
            index=made.index,
            seed=made.seed,
            layout=made.layout,
            kind=made.kind,
            rigid=state is not None and state.item.is_rigid,
            digest="" if state is None else state.digest,
            places=made.places,
            warnings=made.warnings,
            reason=made.reason,
            bodies=None if bodies is None else BodiesMessage.of(bodies),
        )

    @property
    def settled(self) -> int:
        """Number of samples that came to rest."""
        return sum(not warning for warning in self.warnings)
