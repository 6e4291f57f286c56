"""What MDEs learn from."""

from pathlib import Path

import numpy as np
import pytest

from common.domain.deviation import deviation
from common.domain.errors import RequestError
from common.storage.dataset import Dataset
from pipelines.mde.crossfit import OtherSamplesError, read_deviations
from pipelines.mde.examples import Examples, deviation_scale, model_deviations
from pipelines.mde.release import declared_threshold
from services.cli.serve import load_model
from services.heuristic import HeuristicModel
from tests.mde_fakes import Sinking, write_dataset


@pytest.fixture(scope="module")
def dataset(tmp_path_factory: pytest.TempPathFactory) -> Dataset:
    return write_dataset(tmp_path_factory.mktemp("data") / "small")


def test_the_model_that_made_the_outcomes_deviates_from_none_of_them(dataset: Dataset):
    np.testing.assert_allclose(model_deviations(dataset, "train", Sinking()), 0, atol=1e-9)


def test_deviations_come_in_the_order_of_the_samples(dataset: Dataset):
    samples, found = dataset.samples("test"), model_deviations(dataset, "test", HeuristicModel())
    for index in (0, 3, 7):
        state = dataset.state("test", int(samples.groups[index]))
        heights = HeuristicModel().predict(state, samples.actions[index : index + 1]).heights[0]
        assert found[index] == pytest.approx(float(deviation(heights, samples.outcomes[index])))


def test_a_model_of_ones_own_needs_no_code_for_its_mde(dataset: Dataset):
    resting = load_model(str(Path(__file__).parents[3] / "examples" / "fourth_model.py") + ":RestingModel")
    reported: list[int] = []
    found = model_deviations(dataset, "train", resting, report=reported.append)
    assert found.shape == (32,)
    assert (found > 0).all()
    assert reported[-1] == 32


def test_the_scale_is_a_percentile_of_the_heuristic_s_deviations(dataset: Dataset):
    scale_m = deviation_scale(dataset)
    share = (model_deviations(dataset, "train", HeuristicModel()) > scale_m).mean()
    assert share <= 1 / 32
    assert scale_m == round(scale_m, 6)


def test_deviations_are_scaled_and_clipped(dataset: Dataset):
    samples = dataset.samples("test")
    examples = Examples.of(samples, np.linspace(0, 0.004, 8), 0.002)
    np.testing.assert_allclose(examples.deviations, np.minimum(np.linspace(0, 2, 8), 1), rtol=1e-6)
    with pytest.raises(RequestError, match="expected 8 finite numbers"):
        Examples.of(samples, np.zeros(7), 0.002)


def test_the_declared_threshold_lets_about_half_pass():
    assert declared_threshold(np.linspace(0, 0.8, 101)) == 0.4
    assert declared_threshold(np.linspace(0, 0.3, 101)) == pytest.approx(0.15)
    assert declared_threshold(np.zeros(10)) == 0.05


def test_cross_fitted_deviations_come_back(dataset: Dataset, tmp_path: Path):
    path = tmp_path / "deviations.npz"
    np.savez(path, deviation_m=np.arange(32.0), test_deviation_m=np.arange(8.0), version="7")
    found = read_deviations(path, dataset)
    assert found.version == "7"
    assert found.train_m[-1] == 31
    assert found.test_m[-1] == 7


def test_a_shorter_run_of_the_same_data_set_takes_the_first_deviations(dataset: Dataset, tmp_path: Path):
    path = tmp_path / "deviations.npz"
    actions, test_actions = dataset.samples("train").actions, dataset.samples("test").actions
    longer = {"actions": np.vstack([actions, actions]), "deviation_m": np.arange(64.0)}
    np.savez(path, test_actions=test_actions, test_deviation_m=np.arange(8.0), **longer)
    np.testing.assert_array_equal(read_deviations(path, dataset).train_m, np.arange(32.0))


def test_deviations_of_other_samples_are_told_from_those_of_the_data_set(dataset: Dataset, tmp_path: Path):
    path = tmp_path / "deviations.npz"
    actions, test_actions = dataset.samples("train").actions, dataset.samples("test").actions
    values = {"deviation_m": np.arange(32.0), "test_deviation_m": np.arange(8.0)}
    np.savez(path, actions=actions[::-1], test_actions=test_actions, **values)
    with pytest.raises(OtherSamplesError, match="expected those of the data set's samples"):
        read_deviations(path, dataset)


@pytest.mark.parametrize(
    ("arrays", "complaint"),
    [
        ({"deviation_m": np.zeros(32)}, "expected deviation_m and test_deviation_m"),
        ({"deviation_m": np.zeros(31), "test_deviation_m": np.zeros(8)}, "deviation_m: expected 32 finite numbers"),
        ({"deviation_m": np.zeros(32), "test_deviation_m": np.full(8, np.nan)}, "test_deviation_m: expected 8 finite"),
    ],
)
def test_deviations_of_another_data_set_are_refused(
    dataset: Dataset, tmp_path: Path, arrays: dict[str, np.ndarray], complaint: str
):
    np.savez(tmp_path / "deviations.npz", **arrays)
    with pytest.raises(RequestError, match=complaint):
        read_deviations(tmp_path / "deviations.npz", dataset)
    with pytest.raises(RequestError, match="No such file"):
        read_deviations(tmp_path / "nothing.npz", dataset)
