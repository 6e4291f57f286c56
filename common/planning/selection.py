"""The strategies by name."""

from collections.abc import Callable
from functools import partial

from common.domain.errors import RequestError
from common.planning.strategy import Strategy
from common.planning.strategy_only import OnlyStrategy
from common.planning.strategy_random import RandomStrategy
from common.planning.strategy_residual import ResidualStrategy
from common.planning.strategy_threshold import ThresholdStrategy
from common.planning.strategy_transport import TransportStrategy

STRATEGIES: dict[str, Callable[[], Strategy]] = {
    "threshold": ThresholdStrategy,
    "threshold:upper": lambda: ThresholdStrategy(by="upper"),
    "transport": partial(TransportStrategy, name="transport"),
    "quality": partial(TransportStrategy, calls=12, name="quality"),
    "balanced": partial(TransportStrategy, calls=6, name="balanced"),
    "fast": partial(TransportStrategy, calls=3, name="fast"),
    "residual": partial(ResidualStrategy, name="residual"),
    "random": RandomStrategy,
}
"""Strategies without a parameter."""

BUDGETED: dict[str, Callable[[int], Strategy]] = {
    "transport": lambda calls: TransportStrategy(calls=calls),
    "residual": lambda calls: ResidualStrategy(calls=calls),
}
"""Strategies that take ``:calls=<number>``."""

DEFAULT = "quality"
"""See docs/decisions for why; the paper's strategy is ``threshold``."""
MOST_CALLS = 5000
FORMS = ", ".join([*STRATEGIES, *(f"{name}:calls=<number>" for name in BUDGETED), "only:<model>"])


def parse_strategy(text: str) -> Strategy:
    """Return the strategy that ``text`` names, for instance ``threshold``, ``transport:calls=8`` or ``only:heuristic``.

    Raises:
        RequestError: There is none of this name.
    """
    if text in STRATEGIES:
        return STRATEGIES[text]()
    family, _, option = text.partition(":")
    if family == "only" and option:
        return OnlyStrategy(option)
    name, _, number = option.partition("=")
    if family in BUDGETED and name == "calls" and number.isascii() and number.isdigit() and len(number) <= 4:
        if not 1 <= int(number) <= MOST_CALLS:
            raise RequestError(f"strategy {family}: expected 1 to {MOST_CALLS} calls, got {number}")
        return BUDGETED[family](int(number))
    raise RequestError(f"strategy: expected one of {FORMS}, got {text[:80]!r}")
