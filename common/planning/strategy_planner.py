"""A strategy with another planner: the same choice of models for actions that something else chooses."""

from collections.abc import Iterator

from common.planning.plan import Plan, Setting
from common.planning.plan_ucb import MakePlanner, UcbPlan
from common.planning.strategy import Query, Strategy


class PlannerStrategy(Strategy):
    """Ask the models that a strategy names, at the actions that a planner of another make chooses.

    Args:
        chosen: The strategy; it must be one without a plan of its own.
        make_planner: Makes the planner of an optimisation.
        name: What it is called.
    """

    def __init__(self, chosen: Strategy, make_planner: MakePlanner, *, name: str) -> None:
        self.name = name
        self._chosen = chosen
        self._make_planner = make_planner

    def required(self, trusted: str) -> str:
        """Return the model without which the strategy cannot run."""
        return self._chosen.required(trusted)

    def order(self, query: Query) -> Iterator[str]:
        """Yield the models that the strategy names."""
        return self._chosen.order(query)

    def plan(self, setting: Setting) -> Plan:
        """Return the course of an optimisation."""
        return UcbPlan(setting, make_planner=self._make_planner)
