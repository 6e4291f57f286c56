"""A case: one state with a target, and how the target was made."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from common.domain.errors import RequestError
from common.domain.grid import check_heightmap
from common.domain.scene import State


@dataclass(frozen=True)
class Case:
    """One action selection problem with a simulated target.

    Attributes:
        name: Short name, unique in its collection.
        seed: Seed of every random choice that made it.
        state: Scene and item, ``s_0``.
        target: Heightmap to be reached ``(H, W)``, ``s_g`` [m].
        true_action: The hidden action that made the target; None if nobody knows it.
        same_item: Whether the target was made with the state's own item.
        notes: One sentence about what it shows.
        task: The task whose action made the target.

    Raises:
        RequestError: The target does not fit the state, or the action is not finite.
    """

    name: str
    seed: int
    state: State
    target: NDArray[np.float32]
    true_action: tuple[float, ...] | None
    same_item: bool
    notes: str = ""
    task: str = "plating"

    def __post_init__(self) -> None:
        object.__setattr__(self, "target", check_heightmap("target", self.target, self.state.grid))
        if self.true_action is not None and not np.isfinite(self.true_action).all():
            raise RequestError(f"true_action: expected finite numbers, got {self.true_action}")

    @property
    def reference_action(self) -> tuple[float, ...] | None:
        """The action that an answer is compared with; None where another item made the target, or nobody knows it."""
        return self.true_action if self.same_item else None
