"""The strategies by name."""

from collections.abc import Callable

from common.domain.errors import RequestError
from common.planning.strategy import Strategy
from common.planning.strategy_only import OnlyStrategy
from common.planning.strategy_random import RandomStrategy
from common.planning.strategy_threshold import ThresholdStrategy

STRATEGIES: dict[str, Callable[[], Strategy]] = {
    "threshold": ThresholdStrategy,
    "threshold:upper": lambda: ThresholdStrategy(by="upper"),
    "random": RandomStrategy,
}
"""Strategies without a parameter; ``only:<model>`` is the one with."""


def parse_strategy(text: str) -> Strategy:
    """Return the strategy that ``text`` names, for instance ``threshold`` or ``only:heuristic``.

    Raises:
        RequestError: There is none of this name.
    """
    if text in STRATEGIES:
        return STRATEGIES[text]()
    family, _, model = text.partition(":")
    if family == "only" and model:
        return OnlyStrategy(model)
    raise RequestError(f"strategy: expected one of {', '.join(STRATEGIES)}, only:<model>, got {text[:80]!r}")
