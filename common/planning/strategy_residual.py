"""A few calls of the trusted model on what the cheap models do not explain."""

from collections.abc import Iterator

from common.planning.plan import Plan, Setting
from common.planning.plan_residual import ResidualPlan
from common.planning.strategy import Query, Strategy


class ResidualStrategy(Strategy):
    """Ask the trusted model alone for outcomes, see `ResidualPlan`.

    Args:
        calls: Largest number of calls.
        name: What it is called.
    """

    def __init__(self, *, calls: int = 12, name: str | None = None) -> None:
        self.name = f"residual:calls={calls}" if name is None else name
        self._calls = calls

    def required(self, trusted: str) -> str:
        """Return the trusted model."""
        return trusted

    def order(self, query: Query) -> Iterator[str]:
        """Yield the trusted model."""
        yield query.trusted

    def plan(self, setting: Setting) -> Plan:
        """Return the course of an optimisation."""
        return ResidualPlan(setting, calls=self._calls)

    def budget(self, evaluations: int) -> int:
        """Return the number of calls."""
        return min(self._calls, evaluations)
