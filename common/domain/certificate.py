"""What an optimisation can say about what it may have missed."""

from dataclasses import dataclass


@dataclass(frozen=True)
class Certificate:
    """No action on a grid is better than the answer by more than ``gain``, with a probability.

    The probability is over states and targets like those that the bound was calibrated on; it is not that of one state.

    Attributes:
        gain: Largest gain in reward that any action on the grid may bring [m].
        probability: Share of optimisations for which that is true.
        actions: Number of actions on the grid.
        left: Share of them that may be better than the answer: their upper bounds are above its reward.
    """

    gain: float
    probability: float
    actions: int
    left: float
