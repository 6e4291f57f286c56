"""Laws that every MDE obeys."""

from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import numpy as np
import pytest

from common.domain.deviation import DeviationEstimator
from common.domain.errors import RequestError
from common.domain.grid import Grid
from common.domain.scene import Item, Scene, State
from common.storage.dataset import Dataset
from services.mde.estimator import read_estimator
from tests.fakes import Radius
from tests.mde_fakes import small_settings, write_dataset, write_weights

ACTIONS = np.array([[0.01, -0.015], [-0.05, 0.02], [0.03, 0.03], [0.0, -0.05], [0.06, 0.0]])


@pytest.fixture(scope="module")
def dataset(tmp_path_factory: pytest.TempPathFactory) -> Dataset:
    return write_dataset(tmp_path_factory.mktemp("data") / "small")


def trained(dataset: Dataset, folder: Path, variant: str, members: int) -> DeviationEstimator:
    write_weights(folder, dataset, small_settings(variant, members=members, epochs=4))
    return read_estimator(folder, model="heuristic")


ESTIMATORS: dict[str, Callable[[Dataset, Path], DeviationEstimator]] = {
    "crop": lambda dataset, folder: trained(dataset, folder, "crop", 2),
    "paper": lambda dataset, folder: trained(dataset, folder, "paper", 1),
    "radius": lambda dataset, folder: Radius("heuristic"),
}


@pytest.fixture(params=ESTIMATORS, scope="module")
def estimator(
    request: pytest.FixtureRequest, dataset: Dataset, tmp_path_factory: pytest.TempPathFactory
) -> DeviationEstimator:
    return ESTIMATORS[request.param](dataset, tmp_path_factory.mktemp(request.param))


@pytest.fixture(scope="module")
def state(dataset: Dataset) -> State:
    return dataset.state("test", 0)


def test_the_same_question_gets_the_same_answer_to_the_bit(estimator: DeviationEstimator, state: State):
    first, second = (estimator.estimate(state, ACTIONS) for _ in range(2))
    for name in ("mean", "upper", "familiar"):
        np.testing.assert_array_equal(getattr(first, name), getattr(second, name))


def test_an_action_of_a_batch_is_estimated_as_if_alone(estimator: DeviationEstimator, state: State):
    together = estimator.estimate(state, ACTIONS)
    for index, action in enumerate(ACTIONS):
        alone = estimator.estimate(state, action[None])
        assert alone.mean[0] == pytest.approx(together.mean[index], abs=1e-5)
        assert alone.upper[0] == pytest.approx(together.upper[index], abs=1e-5)
        assert alone.familiar[0] == together.familiar[index]


def test_estimates_lie_between_0_and_1_and_below_their_bound(estimator: DeviationEstimator, dataset: Dataset):
    for index in range(dataset.card.states["test"]):
        estimates = estimator.estimate(dataset.state("test", index), ACTIONS)
        assert (estimates.mean >= 0).all()
        assert (estimates.upper <= 1).all()
        assert (estimates.mean <= estimates.upper).all()
        assert estimates.familiar.dtype == np.bool_


def test_a_batch_of_any_size_is_answered(estimator: DeviationEstimator, state: State):
    many = np.random.default_rng(0).uniform(-0.06, 0.06, (150, 2))
    estimates = estimator.estimate(state, many)
    assert estimates.mean.shape == estimates.upper.shape == estimates.familiar.shape == (150,)
    np.testing.assert_allclose(estimates.mean[100:], estimator.estimate(state, many[100:]).mean, atol=1e-5)


def test_a_state_is_not_written_into(estimator: DeviationEstimator, dataset: Dataset):
    state, again = (dataset.state("test", 1) for _ in range(2))
    estimator.estimate(state, ACTIONS)
    np.testing.assert_array_equal(state.scene.heights, again.scene.heights)
    np.testing.assert_array_equal(state.item.materials, again.item.materials)


def test_states_do_not_mix(estimator: DeviationEstimator, dataset: Dataset):
    states = [dataset.state("train", index) for index in range(4)]
    alone = [estimator.estimate(state, ACTIONS).mean for state in states]
    mixed = [estimator.estimate(state, ACTIONS).mean for state in (*states[::-1], *states)][4:]
    np.testing.assert_array_equal(np.stack(alone), np.stack(mixed))


def test_several_threads_at_once_get_the_answers_they_would_get_alone(estimator: DeviationEstimator, dataset: Dataset):
    states = [dataset.state("train", index % 4) for index in range(12)]
    alone = [estimator.estimate(state, ACTIONS).mean for state in states]
    with ThreadPoolExecutor(4) as pool:
        together = list(pool.map(lambda state: estimator.estimate(state, ACTIONS).mean, states))
    np.testing.assert_array_equal(np.stack(together), np.stack(alone))


@pytest.mark.parametrize("actions", [np.zeros(2), np.zeros((0, 2)), np.array([[np.nan, 0.0]])])
def test_senseless_actions_are_the_callers_fault(estimator: DeviationEstimator, state: State, actions: np.ndarray):
    with pytest.raises(RequestError, match="actions: expected"):
        estimator.estimate(state, actions)


@pytest.fixture(scope="module", params=["crop", "paper"])
def network(
    request: pytest.FixtureRequest, dataset: Dataset, tmp_path_factory: pytest.TempPathFactory
) -> DeviationEstimator:
    return ESTIMATORS[request.param](dataset, tmp_path_factory.mktemp(request.param))


def test_a_state_of_another_grid_is_unfamiliar_and_says_why(network: DeviationEstimator):
    grid = Grid(20, 24, 0.01)
    item = np.zeros(grid.shape, np.float32)
    item[8:12, 10:14] = 0.01
    materials = np.where(item > 0, np.array([1000.0, 1e5, 0.4])[:, None, None], 0).astype(np.float32)
    state = State(Scene(grid, np.zeros(grid.shape, np.float32), np.zeros_like(materials)), Item(item, materials))
    estimates = network.estimate(state, ACTIONS)
    assert not estimates.familiar.any()
    np.testing.assert_array_equal(estimates.mean, 1.0)
    assert estimates.reason.startswith("grid: expected")


def test_a_stiffness_outside_the_range_is_unfamiliar_and_says_why(network: DeviationEstimator, dataset: Dataset):
    state = dataset.state("train", 0)
    materials = state.item.materials.copy()
    materials[1][materials[1] > 0] = 1e7
    estimates = network.estimate(State(state.scene, Item(state.item.heights, materials)), ACTIONS)
    assert not estimates.familiar.any()
    assert "Young's modulus" in estimates.reason


def test_an_action_further_out_than_all_others_is_unfamiliar_and_says_why(
    network: DeviationEstimator, dataset: Dataset
):
    actions = np.array([[0.0, 0.01], [0.075, 0.075]])
    estimates = network.estimate(dataset.state("train", 0), actions)
    assert not estimates.familiar[1]
    assert "mm of the plate's centre, got one at 106 mm" in estimates.reason


def test_most_of_what_it_learned_from_is_familiar(network: DeviationEstimator, dataset: Dataset):
    samples = dataset.samples("train")
    flags = [
        network.estimate(dataset.state("train", int(group)), samples.actions[samples.groups == group])
        for group in np.unique(samples.groups)
    ]
    assert np.concatenate([estimates.familiar for estimates in flags]).mean() > 0.9
