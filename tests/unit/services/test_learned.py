"""The learned model: what it sees, what it answers, and what it refuses."""

import json
from pathlib import Path

import numpy as np
import pytest
import torch
from torch import nn

from common.domain.bodies import Bodies, Box, Material
from common.domain.errors import ModelError, RequestError
from common.domain.grid import Grid
from common.domain.scene import Item, Scene, State
from common.learning.features import SYMMETRIES, transform, transform_actions
from common.learning.training import seeded
from common.learning.weights import CARD, TENSORS
from common.tasks.plating import dinner_plate, render_scene
from services.heuristic import HeuristicModel
from services.learned.model import LearnedModel
from services.learned.network import NetworkSettings, ResidualNetwork
from services.learned.windows import Views, residuals
from tests.learned_fakes import GRID, make_network, save_learned

FRIES = (
    Box(
        np.array([0.06, 0.01, 0.01]),
        np.array([0.02, 0.0, 0.005]),
        np.array([0.0, 0.0, 0.2, 0.98]),
        Material(550, 1e6, 0.3),
    ),
    Box(
        np.array([0.06, 0.01, 0.01]),
        np.array([-0.05, 0.03, 0.005]),
        np.array([0.0, 0.0, 0.6, 0.8]),
        Material(550, 1e6, 0.3),
    ),
)
ACTIONS = np.array([[0.0101, -0.0153], [-0.05, 0.02], [0.079, 0.079]])


def make_state(grid: Grid = GRID) -> State:
    inside = (np.abs(grid.x[None, :] - 0.003) < 0.04) & (np.abs(grid.y[:, None]) < 0.025)
    heights = np.where(inside, 0.02 + 0.05 * grid.x[None, :], 0.0)
    materials = np.where(inside, np.array([1050.0, 1e5, 0.4])[:, None, None], 0.0)
    scene = render_scene(grid, Bodies(dinner_plate(), FRIES))
    return State(scene, Item(heights.astype(np.float32), materials.astype(np.float32)))


def make_model(std: float = 0.3, *, bfloat16: bool | None = None) -> LearnedModel:
    return LearnedModel(make_network(std), version="1", bfloat16=bfloat16)


def turned(state: State, symmetry: int) -> State:
    scene, item = state.scene, state.item
    arrays = scene.heights, scene.materials, item.heights, item.materials
    heights, materials, item_heights, item_materials = (
        transform(torch.tensor(array), symmetry).numpy() for array in arrays
    )
    return State(Scene(GRID, heights, materials), Item(item_heights, item_materials))


def test_untrained_it_answers_the_heuristic_sum_to_the_bit():
    state = make_state()
    expected = HeuristicModel().predict(state, ACTIONS).heights
    np.testing.assert_array_equal(make_model(std=0.0).predict(state, ACTIONS).heights, expected)


def test_it_answers_the_heuristic_sum_corrected_by_what_the_network_says():
    state, model = make_state(), make_model(std=0.04, bfloat16=False)
    views = Views.of(
        *(
            array[None]
            for array in (state.scene.heights, state.scene.materials, state.item.heights, state.item.materials)
        )
    )
    action = ACTIONS[:1]
    outcome = model.predict(state, action).heights
    inputs, first = views.inputs(action, GRID, 32)
    network = make_network(0.04)
    mirrored = network(inputs.flip(-1)).flip(-1)
    expected = ((network(inputs) + mirrored) / 2).detach().numpy()
    found = residuals(inputs, first, outcome, state.scene.heights[None]).numpy()
    assert outcome.min() == state.scene.heights.min()  # nothing had to be lifted on the table
    np.testing.assert_allclose(found, np.where(np.abs(expected) < 0.03, 0, expected), atol=1e-4)


def test_in_bfloat16_its_correction_is_the_same_within_two_percent():
    state = make_state()
    exact, narrow, none = (
        make_model(bfloat16=False), make_model(bfloat16=True), make_model(std=0.0, bfloat16=False),
    )  # fmt: skip
    outcomes, found, sums = (model.predict(state, ACTIONS).heights for model in (exact, narrow, none))
    assert (found != outcomes).any()
    assert np.abs(found - outcomes).mean() < 0.02 * np.abs(outcomes - sums).mean()


def test_far_from_the_item_and_from_all_fries_the_answer_is_the_scene_itself():
    state = make_state()
    outcome = make_model(std=3.0).predict(state, np.array([[0.05, -0.05]])).heights[0]
    rows, columns = np.mgrid[: GRID.rows, : GRID.columns]
    far = np.hypot(GRID.x[None, :] - 0.05, GRID.y[:, None] + 0.05) > 0.09
    for row, column in np.argwhere(state.scene.materials[0] > 0):
        far &= np.maximum(abs(rows - row), abs(columns - column)) > 8
    assert far.sum() > 500
    np.testing.assert_array_equal(outcome[far], state.scene.heights[far])
    assert (outcome != HeuristicModel().predict(state, np.array([[0.05, -0.05]])).heights[0]).any()


@pytest.mark.parametrize("symmetry", range(1, SYMMETRIES))
def test_what_the_network_sees_turns_with_state_and_action(symmetry: int):
    odd = Grid(49, 49, 0.005)
    state = make_state(odd)
    arrays = [
        array[None] for array in (state.scene.heights, state.scene.materials, state.item.heights, state.item.materials)
    ]
    action = np.array([[0.0123, -0.0211]])
    inputs, _ = Views.of(*arrays).inputs(action, odd, 33)
    views = Views.of(*(transform(torch.tensor(array), symmetry).numpy() for array in arrays))
    moved, _ = views.inputs(transform_actions(action, symmetry), odd, 33)
    np.testing.assert_allclose(transform(inputs, symmetry).numpy(), moved.numpy(), atol=2e-5)


def test_saved_and_loaded_it_answers_the_same(tmp_path: Path):
    card = save_learned(tmp_path)
    loaded = LearnedModel.load(tmp_path)
    assert (loaded.version, loaded.weights, loaded.grid) == ("7", card.sha256, GRID)
    np.testing.assert_array_equal(
        loaded.predict(make_state(), ACTIONS).heights, make_model().predict(make_state(), ACTIONS).heights
    )


def test_another_grid_is_the_callers_fault():
    other = Grid(48, 48, 0.004)
    with pytest.raises(RequestError, match=r"expected Grid\(rows=48, columns=48, cell=0.005\).*got Grid\(.*0.004\)"):
        make_model().predict(make_state(other), ACTIONS)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"sha256": "0" * 64}, "expected SHA-256 0{64} as its card says"),
        ({"architecture": "paper"}, "expected a network of the architecture residual-window-2, got 'paper'"),
        ({"name": "mde_learned"}, "expected weights of learned"),
        ({"settings": {}}, "expected the network's settings"),
        ({"grid": {"rows": 48, "columns": 1, "cell": 0.005}}, "expected a grid of at least 2 x 2"),
        (
            {"grid": {"rows": 96, "columns": 96, "cell": 0.003}},
            r"the grid of the weights, Grid\(rows=48, .*got Grid\(rows=96",
        ),
    ],
)
def test_a_card_that_lies_is_refused(tmp_path: Path, change: dict, message: str):
    card = save_learned(tmp_path)
    (tmp_path / CARD).write_text(json.dumps({**card.model_dump(), **change}))
    with pytest.raises(ModelError, match=message):
        LearnedModel.load(tmp_path)


@pytest.mark.parametrize("widths", [[8, 8], [8, 8, 9], [8, 8, 0], "888", [8, 8, 2**40]])
def test_sizes_that_do_not_fit_the_weights_are_refused(tmp_path: Path, widths: object):
    card = save_learned(tmp_path)
    settings = {**card.settings, "network": {**card.settings["network"], "widths": widths}}
    (tmp_path / CARD).write_text(json.dumps({**card.model_dump(), "settings": settings}))
    with pytest.raises(ModelError, match="expected"):
        LearnedModel.load(tmp_path)


def test_weights_that_were_cut_short_are_refused(tmp_path: Path):
    save_learned(tmp_path)
    content = (tmp_path / TENSORS).read_bytes()
    (tmp_path / TENSORS).write_bytes(content[:-100])
    with pytest.raises(ModelError, match="expected SHA-256"):
        LearnedModel.load(tmp_path)


def test_a_window_must_be_a_multiple_of_eight_cells():
    with pytest.raises(ValueError, match="multiple of 8"):
        NetworkSettings(window=30)


def test_a_network_answers_zero_where_nothing_can_change():
    with seeded(1):
        network = ResidualNetwork(
            NetworkSettings(window=32, widths=(8, 8, 8), blocks=1, item_reach=2, fry_reach=3), GRID
        )
    nn.init.normal_(network.exit.weight)
    inputs = torch.zeros(1, 12, 32, 32)
    inputs[:, 0] = 1.0
    inputs[:, 1, 10, 10] = 1.0
    inputs[:, 6, 20, 25] = 1.0
    rows, columns = np.nonzero(network(inputs)[0].detach().numpy())
    near_fry = np.maximum(abs(rows - 10), abs(columns - 10)) <= 3
    near_item = np.maximum(abs(rows - 20), abs(columns - 25)) <= 2
    assert (near_fry | near_item).all()
    assert len(rows) == 7 * 7 + 5 * 5
