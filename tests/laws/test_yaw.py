"""Laws that every model of plating obeys where the item may be turned."""

from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor

import numpy as np
import pytest
from torch import nn

from common.domain.bodies import Bodies, Box, Material, Plate
from common.domain.deviation import deviation
from common.domain.grid import Grid
from common.domain.model import PredictiveModel
from common.domain.scene import Item, Scene, State
from common.learning.training import seeded
from common.tasks import TASKS
from common.tasks.plating import dinner_plate, render_scene
from common.tasks.plating_items import TwoLobes, Wavy, draw_item
from common.tasks.plating_turn import TurnedModel, turned_state
from services.heuristic import HeuristicModel
from services.learned.model import LearnedModel
from services.learned.network import NetworkSettings, ResidualNetwork
from services.simulator.model import SimulatorModel
from tests.laws.test_models import fourth_model

GRID = Grid(72, 72, 0.004)
TASK = TASKS["plating_yaw"]
ACTIONS = np.array([[0.012, -0.015, 0.4], [-0.03, 0.02, -2.1], [0.01, -0.01, 3.0]])


def learned_model() -> PredictiveModel:
    with seeded(0):
        network = ResidualNetwork(NetworkSettings(window=48, widths=(8, 8, 8), blocks=1), GRID)
        nn.init.normal_(network.exit.weight, std=0.002)
    return LearnedModel(network, version="1")


MODELS: dict[str, Callable[[], PredictiveModel]] = {
    "heuristic": HeuristicModel,
    "learned": learned_model,
    "simulator": SimulatorModel,
    "resting": fourth_model,
}
EQUIVARIANT = [name for name in MODELS if name != "learned"]
"""Models that prefer no direction; an untrained network does."""


@pytest.fixture(scope="module")
def plain(request: pytest.FixtureRequest) -> PredictiveModel:
    return MODELS[request.param]()


def a_state(modulus: float, *, is_round: bool = False) -> State:
    turn = np.array([0.0, 0.0, np.sin(0.2), np.cos(0.2)])
    fry = Box(np.array([0.06, 0.01, 0.01]), np.array([0.02, 0.0, 0.005]), turn, Material(550.0, 1e6, 0.3))
    outline = Wavy(0.08, 0.08) if is_round else TwoLobes(0.12, 0.08, 0.4)
    item = draw_item(GRID, outline, thickness=0.018, material=Material(1050.0, modulus, 0.4))
    return State(render_scene(GRID, Bodies(dinner_plate(), (fry,))), item)


STATES = {"soft": a_state(1e5), "rigid": a_state(1e9)}


def quarter(image: np.ndarray) -> np.ndarray:
    """Turn an image from x to y; rows grow along y."""
    return np.rot90(image, -1, axes=(-2, -1))


def quarter_state(state: State) -> State:
    """Turn the whole plate with all that is on it, and the item, from x to y."""
    scene, item = state.scene, state.item
    assert scene.bodies is not None
    half = np.sqrt(0.5)

    def turned(box: Box) -> Box:
        (x, y, z), (i, j, k, w) = box.position, box.orientation
        orientation = half * np.array([i - j, i + j, k + w, w - k])
        return Box(box.size, np.array([-y, x, z]), orientation, box.material)

    bodies = Bodies(scene.bodies.plate, tuple(turned(box) for box in scene.bodies.boxes))
    return State(
        Scene(state.grid, quarter(scene.heights), quarter(scene.materials), bodies),
        Item(quarter(item.heights), quarter(item.materials)),
    )


@pytest.mark.parametrize("plain", MODELS, indirect=True)
@pytest.mark.parametrize("kind", STATES)
def test_yaw_0_is_plating_to_the_bit(plain: PredictiveModel, kind: str):
    actions = np.column_stack([ACTIONS[:, :2], np.zeros(len(ACTIONS))])
    turned = TASK.adapt_model(plain).predict(STATES[kind], actions)
    upright = TASKS["plating"].adapt_model(plain).predict(STATES[kind], ACTIONS[:, :2])
    np.testing.assert_array_equal(turned.heights, upright.heights)
    assert (turned.model, turned.version, turned.warnings) == (upright.model, upright.version, upright.warnings)


@pytest.mark.parametrize("plain", MODELS, indirect=True)
@pytest.mark.parametrize("kind", STATES)
def test_a_yaw_is_the_action_in_the_state_whose_item_was_turned(plain: PredictiveModel, kind: str):
    predicted = TASK.adapt_model(plain).predict(STATES[kind], ACTIONS[:1]).heights[0]
    turned = plain.predict(turned_state(STATES[kind], float(ACTIONS[0, 2])), ACTIONS[:1, :2]).heights[0]
    if plain.name != "simulator":
        np.testing.assert_array_equal(predicted, turned)
        return
    # The simulator turns its bodies, not the heightmap: cells at the edge differ, 4 mm wide here.
    unturned = plain.predict(STATES[kind], ACTIONS[:1, :2]).heights[0]
    assert deviation(predicted, turned) < 0.25 * deviation(unturned, turned)


@pytest.mark.parametrize("plain", EQUIVARIANT, indirect=True)
@pytest.mark.parametrize("kind", STATES)
def test_turning_everything_by_a_quarter_turns_the_answer(plain: PredictiveModel, kind: str):
    model, (x, y, yaw) = TASK.adapt_model(plain), ACTIONS[0]
    before = model.predict(STATES[kind], np.array([[x, y, yaw]])).heights[0]
    after = model.predict(quarter_state(STATES[kind]), np.array([[-y, x, yaw]])).heights[0]
    still = model.predict(STATES[kind], np.array([[-y, x, yaw]])).heights[0]
    assert deviation(after, quarter(before)) < 0.04 * deviation(still, quarter(before))


@pytest.mark.parametrize("plain", EQUIVARIANT, indirect=True)
def test_turning_a_round_item_changes_nothing_but_cells_at_its_edge(plain: PredictiveModel):
    model, actions = TASK.adapt_model(plain), np.array([[-0.03, 0.01, 0.0], [-0.03, 0.01, 0.9]])
    as_it_lies, turned = model.predict(a_state(1e9, is_round=True), actions).heights
    long, turned_long = model.predict(STATES["rigid"], actions).heights
    assert deviation(as_it_lies, turned) < 0.12 * deviation(long, turned_long)


@pytest.mark.parametrize("plain", MODELS, indirect=True)
def test_an_action_of_a_batch_is_predicted_as_if_alone(plain: PredictiveModel):
    model = TASK.adapt_model(plain)
    together = model.predict(STATES["rigid"], ACTIONS).heights
    alone = np.concatenate([model.predict(STATES["rigid"], action[None]).heights for action in ACTIONS])
    np.testing.assert_array_equal(together, alone)


@pytest.mark.parametrize("plain", MODELS, indirect=True)
def test_several_threads_at_once_get_the_answers_they_would_get_alone(plain: PredictiveModel):
    model = TASK.adapt_model(plain)
    alone = [model.predict(STATES["rigid"], action[None]).heights for action in ACTIONS]
    with ThreadPoolExecutor(3) as pool:
        together = list(pool.map(lambda action: model.predict(STATES["rigid"], action[None]).heights, ACTIONS))
    np.testing.assert_array_equal(np.stack(together), np.stack(alone))


def test_the_simulator_turns_its_bodies_and_meshes_nothing_again():
    simulator = SimulatorModel()
    assert TASK.adapt_model(simulator) is simulator
    assert isinstance(TASK.adapt_model(HeuristicModel()), TurnedModel)
    simulator.predict(STATES["rigid"], ACTIONS)
    placement = simulator.placement(STATES["rigid"])
    simulator.predict(STATES["rigid"], ACTIONS + np.array([0, 0, 0.1]))
    assert simulator.placement(STATES["rigid"]) is placement


def test_a_scene_whose_bodies_have_to_be_found_is_looked_at_once_for_all_yaws(monkeypatch: pytest.MonkeyPatch):
    looked: list[State] = []
    find = SimulatorModel._bodies

    def count(self: SimulatorModel, state: State) -> Bodies:
        looked.append(state)
        return find(self, state)

    monkeypatch.setattr(SimulatorModel, "_bodies", count)
    SimulatorModel().predict(STATES["rigid"], ACTIONS)
    assert len(looked) == 1


def test_the_plate_has_no_direction():
    plate = dinner_plate()
    assert isinstance(plate, Plate)
    np.testing.assert_array_equal(quarter(plate.heightmap(GRID)), plate.heightmap(GRID))
