"""Ours: simulate where the cheap models point, then where the simulations themselves point."""

from collections.abc import Iterator

from common.planning.plan import Plan, Setting
from common.planning.plan_transport import TransportPlan
from common.planning.strategy import Query, Strategy

CALLS = 12
QUICK = 4
"""With so few calls the dearer cheap models are asked less often: they would cost more than they bring."""


class TransportStrategy(Strategy):
    """Ask the trusted model alone for outcomes, a few of them, see `TransportPlan`.

    Args:
        calls: Largest number of calls.
        name: What it is called.
    """

    def __init__(self, *, calls: int = CALLS, name: str | None = None) -> None:
        self.name = f"transport:calls={calls}" if name is None else name
        self._calls = calls

    def required(self, trusted: str) -> str:
        """Return the trusted model."""
        return trusted

    def order(self, query: Query) -> Iterator[str]:
        """Yield the trusted model."""
        yield query.trusted

    def plan(self, setting: Setting) -> Plan:
        """Return the course of an optimisation."""
        return TransportPlan(setting, calls=self._calls, hasty=self._calls <= QUICK)

    def budget(self, evaluations: int) -> int:
        """Return the number of calls."""
        return min(self._calls, evaluations)
