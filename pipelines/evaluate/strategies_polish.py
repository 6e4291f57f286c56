"""Baseline: optimise the cheapest model, then polish its answer by a few simulations. No MDE, no other model."""

from collections.abc import Iterator
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from common.domain.deviation import Estimates
from common.planning.plan import Plan, Setting, Survey
from common.planning.plan_residual import ResidualPlan
from common.planning.strategy import Query, Strategy


class PolishStrategy(Strategy):
    """Sweep the cheapest model, simulate where it points, and go on with GP-UCB on what it gets wrong.

    It is `residual` without everything that needs more than one cheap model and calls of the trusted one.

    Args:
        calls: Largest number of calls of the trusted model.
    """

    def __init__(self, calls: int) -> None:
        self.name = f"polish:calls={calls}"
        self._calls = calls

    def required(self, trusted: str) -> str:
        """Return the trusted model."""
        return trusted

    def order(self, query: Query) -> Iterator[str]:
        """Yield the trusted model."""
        yield query.trusted

    def plan(self, setting: Setting) -> Plan:
        """Return the course of an optimisation."""
        alone = replace(setting, models=(*setting.cheap[:1], setting.trusted), survey=_Unestimated(setting.survey))
        return ResidualPlan(alone, calls=self._calls)

    def budget(self, evaluations: int) -> int:
        """Return the number of calls."""
        return min(self._calls, evaluations)


class _Unestimated:
    """A survey in which nobody has an MDE."""

    def __init__(self, survey: Survey) -> None:
        self._survey = survey

    def rewards(self, model: str, actions: NDArray[np.float64]) -> NDArray[np.float64] | None:
        """Return what the survey says."""
        return self._survey.rewards(model, actions)

    def estimates(self, model: str, actions: NDArray[np.float64]) -> Estimates | None:
        """Return None."""
        return None
