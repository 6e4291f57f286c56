"""The paper's strategy: the cheapest model whose estimated deviation is below ``d_max``."""

from collections.abc import Iterator
from typing import Literal

from common.planning.strategy import Query, Strategy


class ThresholdStrategy(Strategy):
    """Try the applicable models from cheapest to dearest, then the trusted one.

    A model is applicable if its MDE knows situations like this one and estimates less than ``d_max``; a model
    without an MDE never is.

    Args:
        by: Whether the expected deviation or its upper bound is compared with ``d_max``.
    """

    def __init__(self, *, by: Literal["mean", "upper"] = "mean") -> None:
        self.name = "threshold" if by == "mean" else f"threshold:{by}"
        self._by: Literal["mean", "upper"] = by

    def required(self, trusted: str) -> str:
        """Return the trusted model."""
        return trusted

    def order(self, query: Query) -> Iterator[str]:
        """Yield the applicable models, the cheapest first, then the trusted one."""
        for model in query.models:
            if model == query.trusted:
                continue
            estimate = query.estimate(model)
            if estimate is None or not estimate.familiar:
                continue
            if (estimate.mean if self._by == "mean" else estimate.upper) < query.d_max:
                yield model
        yield query.trusted
