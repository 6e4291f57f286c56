"""Laws that every model obeys."""

import importlib.util
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import numpy as np
import pytest
from torch import nn

from common.domain.bodies import Bodies, Box, Material
from common.domain.errors import RequestError
from common.domain.grid import Grid
from common.domain.model import PredictiveModel
from common.domain.scene import Item, State
from common.learning.training import seeded
from common.tasks.plating import dinner_plate, render_scene
from services.heuristic import HeuristicModel
from services.learned.model import LearnedModel
from services.learned.network import NetworkSettings, ResidualNetwork
from services.simulator.model import SimulatorModel


def fourth_model() -> PredictiveModel:
    path = Path(__file__).parents[2] / "examples" / "fourth_model.py"
    spec = importlib.util.spec_from_file_location("fourth_model", path)
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module.RestingModel()


def learned_model() -> PredictiveModel:
    with seeded(0):
        network = ResidualNetwork(NetworkSettings(window=48, widths=(8, 8, 8), blocks=1), GRID)
        nn.init.normal_(network.exit.weight, std=0.002)  # so small that the heuristic's laws still hold
    return LearnedModel(network, version="1")


MODELS: dict[str, Callable[[], PredictiveModel]] = {
    "heuristic": HeuristicModel,
    "learned": learned_model,
    "simulator": SimulatorModel,
    "resting": fourth_model,
}
GRID = Grid(64, 72, 0.004)
FRY = Material(550.0, 1e6, 0.3)


@pytest.fixture(params=MODELS, scope="module")
def model(request: pytest.FixtureRequest) -> PredictiveModel:
    return MODELS[request.param]()


def a_state(modulus: float) -> State:
    turn = np.array([0.0, 0.0, np.sin(0.2), np.cos(0.2)])
    fry = Box(np.array([0.06, 0.01, 0.01]), np.array([0.02, 0.0, 0.005]), turn, FRY)
    heights = np.where((np.abs(GRID.x[None, :]) < 0.05) & (np.abs(GRID.y[:, None]) < 0.03), 0.02, 0.0)
    material = np.array([1050.0, modulus, 0.4])[:, None, None]
    return State(
        render_scene(GRID, Bodies(dinner_plate(), (fry,))),
        Item(heights.astype(np.float32), np.where(heights > 0, material, 0).astype(np.float32)),
    )


STATES = {"soft": a_state(1e5), "rigid": a_state(1e9)}
ACTIONS = np.array([[0.01, -0.015], [-0.05, 0.02]])


@pytest.mark.parametrize("kind", STATES)
def test_the_same_question_gets_the_same_answer_to_the_bit(model: PredictiveModel, kind: str):
    first, second = (model.predict(STATES[kind], ACTIONS).heights for _ in range(2))
    np.testing.assert_array_equal(first, second)


@pytest.mark.parametrize("kind", STATES)
def test_an_action_of_a_batch_is_predicted_as_if_alone(model: PredictiveModel, kind: str):
    together = model.predict(STATES[kind], ACTIONS).heights
    alone = np.concatenate([model.predict(STATES[kind], action[None]).heights for action in ACTIONS])
    np.testing.assert_array_equal(together, alone)


@pytest.mark.parametrize("kind", STATES)
def test_predictions_have_the_states_grid_and_are_on_the_plate(model: PredictiveModel, kind: str):
    predictions = model.predict(STATES[kind], ACTIONS)
    assert predictions.heights.shape == (2, *GRID.shape)
    assert predictions.heights.dtype == np.float32
    assert predictions.heights.max() < 0.07
    assert predictions.heights.min() >= STATES[kind].scene.heights.min() - 1e-3
    assert (predictions.model, predictions.version) == (model.name, model.version)


def test_on_bare_flat_plate_the_item_lies_where_the_action_says_as_thick_as_it_is(model: PredictiveModel):
    state = STATES["rigid"]
    bare = State(render_scene(GRID, Bodies(dinner_plate(), ())), state.item)
    heights = model.predict(bare, np.zeros((1, 2))).heights[0]
    covered = state.item.heights > 0
    np.testing.assert_allclose(heights[covered], 0.02, atol=5e-4)
    away = ~(np.pad(covered, 1)[:-2, 1:-1] | np.pad(covered, 1)[2:, 1:-1] | covered)
    away &= ~(np.pad(covered, 1)[1:-1, :-2] | np.pad(covered, 1)[1:-1, 2:])
    np.testing.assert_allclose(heights[away], bare.scene.heights[away], atol=1e-6)


def test_a_state_is_not_written_into(model: PredictiveModel):
    digest = STATES["soft"].digest
    model.predict(STATES["soft"], ACTIONS[:1])
    assert a_state(1e5).digest == digest


@pytest.mark.parametrize("actions", [np.zeros(2), np.zeros((0, 2)), np.array([[np.nan, 0.0]])])
def test_senseless_actions_are_the_callers_fault(model: PredictiveModel, actions: np.ndarray):
    with pytest.raises(RequestError, match="actions: expected"):
        model.predict(STATES["soft"], actions)


def test_several_threads_at_once_get_the_answers_they_would_get_alone(model: PredictiveModel):
    actions = np.array([[0.01, -0.015], [-0.05, 0.02], [0.03, 0.03], [0.0, -0.05]])
    alone = [model.predict(STATES["rigid"], action[None]).heights for action in actions]
    with ThreadPoolExecutor(4) as pool:
        together = list(pool.map(lambda action: model.predict(STATES["rigid"], action[None]).heights, actions))
    np.testing.assert_array_equal(np.stack(together), np.stack(alone))
