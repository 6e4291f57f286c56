"""A cheaper level of the trusted model is optimised before it."""

from dataclasses import dataclass
from types import MappingProxyType

import numpy as np
import pytest
from numpy.typing import NDArray
from planning_fakes import TRUE_ACTION, FakeModel, small_state

from common.domain.errors import ModelError
from common.domain.grid import Floats
from common.domain.model import PredictiveModel
from common.domain.scene import State
from common.domain.trial import Result
from common.planning.optimize import optimize
from common.planning.problem import Problem
from common.tasks.plating import Plating
from services.heuristic import HeuristicModel

STATE = small_state()


@dataclass
class Sinking(FakeModel):
    """The item sinks into what is below it; everything lies higher by ``bias`` [m], the item ``aside`` of its place."""

    bias: float = 0.0
    aside: float = 0.0

    def outcomes(self, state: State, actions: NDArray[np.float64]) -> tuple[Floats, tuple[str, ...]]:
        heights, warnings = super().outcomes(state, actions + self.aside)
        return heights - 0.4 * state.scene.heights * (heights > state.scene.heights) + self.bias, warnings


def run(strategy: str, *models: PredictiveModel, **options: int) -> Result:
    target = Sinking().predict(STATE, np.array([TRUE_ACTION])).heights[0]
    problem = Problem(Layered(), STATE, target)
    return optimize(problem, {model.name: model for model in models}, {}, strategy=strategy, **options)


class Layered(Plating):
    levels = MappingProxyType({"simulator": "simulator_coarse"})


def family(level: PredictiveModel) -> tuple[PredictiveModel, ...]:
    return HeuristicModel(), FakeModel("learned"), level, Sinking("simulator")


@pytest.mark.parametrize("in_flight", [1, 2, 3])
@pytest.mark.parametrize(("strategy", "most"), [("quality", 2), ("balanced", 1), ("fast", 1)])
def test_a_level_that_agrees_leaves_the_trusted_model_few_calls(strategy: str, most: int, in_flight: int):
    level = Sinking("simulator_coarse", bias=1e-5)
    result = run(strategy, *family(level), in_flight=in_flight)
    assert 1 <= result.usage["simulator"] <= max(most, in_flight)
    assert {trial.model for trial in result.trials} == {"simulator"}
    assert result.usage["simulator_coarse"] == level.calls
    assert np.linalg.norm(np.array(result.action) - TRUE_ACTION) < 1e-3


def test_one_that_does_not_agree_leaves_them_all():
    result = run("balanced", *family(Sinking("simulator_coarse", bias=1e-3, aside=4e-3)))
    assert result.usage["simulator"] > 1
    assert np.linalg.norm(np.array(result.action) - TRUE_ACTION) < 1e-3


@pytest.mark.parametrize("after", [0, 1, 2])
def test_one_that_fails_is_done_without(after: int):
    level = Sinking("simulator_coarse", error=ModelError("bad"), fails=lambda call: call >= after, aside=4e-3)
    result = run("quality", *family(level))
    assert np.linalg.norm(np.array(result.action) - TRUE_ACTION) < 1e-3
    assert any("bad" in event.detail for event in result.events)


def test_where_the_first_trusted_call_fails_the_rehearsal_is_not_taken_for_confirmed():
    trusted = Sinking("simulator", error=ModelError("slipped"), fails=lambda call: call == 0)
    *cheap, _ = family(Sinking("simulator_coarse", bias=1e-3, aside=4e-3))
    result = run("quality", *cheap, trusted)
    assert np.linalg.norm(np.array(result.action) - TRUE_ACTION) < 1e-3


def test_a_third_cheap_model_that_is_no_level_is_swept_and_leaves_the_trusted_one_its_calls():
    third = Sinking("third", aside=4e-3)
    result = run("balanced", *family(third))
    assert 6 <= result.usage["third"] <= 30
    assert result.usage["simulator"] > 1
