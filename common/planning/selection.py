"""The strategies by name."""

from collections.abc import Callable
from functools import partial

from common.domain.errors import RequestError
from common.planning.plan_ucb import MakePlanner
from common.planning.planner_sklearn import SklearnPlanner
from common.planning.strategy import Strategy
from common.planning.strategy_only import OnlyStrategy
from common.planning.strategy_planner import PlannerStrategy
from common.planning.strategy_random import RandomStrategy
from common.planning.strategy_residual import ResidualStrategy
from common.planning.strategy_threshold import ThresholdStrategy
from common.planning.strategy_transport import TransportStrategy

STRATEGIES: dict[str, Callable[[], Strategy]] = {
    "threshold": ThresholdStrategy,
    "threshold:upper": lambda: ThresholdStrategy(by="upper"),
    "transport": partial(TransportStrategy, name="transport"),
    "quality": partial(TransportStrategy, calls=12, name="quality"),
    "balanced": partial(TransportStrategy, calls=4, name="balanced"),
    "fast": partial(TransportStrategy, calls=2, name="fast"),
    "residual": partial(ResidualStrategy, name="residual"),
    "random": RandomStrategy,
}
"""Strategies without a parameter."""

BUDGETED: dict[str, Callable[[int], Strategy]] = {
    "transport": lambda calls: TransportStrategy(calls=calls),
    "residual": lambda calls: ResidualStrategy(calls=calls),
}
"""Strategies that take ``:calls=<number>``."""

PLANNERS: dict[str, MakePlanner] = {"scikit-learn": SklearnPlanner}
"""Planners other than our own, ``<strategy>@<planner>``; for strategies that leave the actions to GP-UCB."""

DEFAULT = "quality"
"""See docs/decisions for why; the paper's strategy is ``threshold``."""
MOST_CALLS = 5000
FORMS = ", ".join([*STRATEGIES, *(f"{name}:calls=<number>" for name in BUDGETED), "only:<model>"])
"""What a strategy may be called, each but those with a plan of their own also with ``@<planner>``."""


def parse_strategy(text: str) -> Strategy:
    """Return the strategy that ``text`` names, for instance ``threshold``, ``transport:calls=8`` or ``only:heuristic``.

    ``threshold@scikit-learn`` is `threshold` with the planner of this name.

    Raises:
        RequestError: There is none of this name.
    """
    rest, at, planner = text.partition("@")
    if at:
        return _with_planner(rest, planner)
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


def _with_planner(text: str, planner: str) -> Strategy:
    if planner not in PLANNERS:
        raise RequestError(f"strategy: expected a planner of {', '.join(PLANNERS)} after @, got {planner[:80]!r}")
    chosen = parse_strategy(text)
    if type(chosen).plan is not Strategy.plan:
        raise RequestError(f"strategy: expected one that leaves the actions to GP-UCB before @, got {text[:80]!r}")
    return PlannerStrategy(chosen, PLANNERS[planner], name=f"{chosen.name}@{planner}")
