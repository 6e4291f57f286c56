"""Which action is tried next."""

from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest

from common.domain.errors import RequestError
from common.learning.training import threads
from pipelines.mde.active import ACQUISITIONS, AcquisitionName, belief_of, choose_next, points_of
from pipelines.mde.active_belief import Belief, Points, believe
from services.mde.ensemble import Calibrated, load_ensemble
from tests.mde_fakes import make_trials, small_settings, write_dataset, write_weights

UNCERTAIN: tuple[AcquisitionName, ...] = ("lcb", "variance", "integrated")


@pytest.fixture(scope="module", autouse=True)
def one_thread() -> Iterator[None]:
    with threads(1):
        yield


@pytest.fixture(scope="module")
def base(tmp_path_factory: pytest.TempPathFactory) -> Calibrated:
    folder = tmp_path_factory.mktemp("base")
    write_weights(folder / "mde", write_dataset(folder / "small"), small_settings())
    return load_ensemble(folder / "mde", model="heuristic")


def at(*described: float, estimates: float = 0.3) -> Points:
    """Return points on a line."""
    return Points(np.array(described)[:, None], np.full(len(described), estimates))


def test_the_belief_is_that_of_a_gaussian_process():
    known, points = at(0.0, 0.5, 2.0), at(0.1, 1.0)
    deviations = np.array([0.4, 0.5, 0.2])
    found = believe(known, deviations, points, candidates=2)

    def kernel(one: np.ndarray, two: np.ndarray, scale: float) -> np.ndarray:
        distance = np.sqrt(5) * np.abs(one - two.T) / scale
        return 1 + one * two.T + (1 + distance + distance**2 / 3) * np.exp(-distance)

    expected = []
    for scale in (0.5, 1.0, 2.0):
        for noise in (0.1, 0.3, 1.0):
            covariance = kernel(known.described, known.described, scale) + noise * np.eye(3)
            cross = kernel(known.described, points.described, scale)
            residuals = deviations - 0.3
            variance = (3 * 0.1**2 + residuals @ np.linalg.solve(covariance, residuals)) / 6
            likelihood = -np.linalg.slogdet(covariance)[1] / 2 - 3 * np.log(variance)
            mean = 0.3 + cross.T @ np.linalg.solve(covariance, residuals)
            left = kernel(points.described, points.described, scale) - cross.T @ np.linalg.solve(covariance, cross)
            expected.append((likelihood, mean, variance * left, variance * noise))
    _, mean, covariance, noise = max(expected, key=lambda one: one[0])
    np.testing.assert_allclose(found.mean, mean)
    np.testing.assert_allclose(found.covariance, covariance, atol=1e-12)
    assert found.noise == pytest.approx(noise)


def test_trials_make_their_surroundings_more_certain_and_the_far_less():
    belief = believe(at(0.0, 0.0), np.array([0.5, 0.5]), at(0.0, 1.0, 4.0), candidates=3)
    assert belief.variance[0] < belief.variance[1] < belief.variance[2]
    assert belief.mean[0] > belief.mean[1] > 0.3


def test_without_trials_the_mde_is_believed():
    belief = believe(Points(np.empty((0, 1)), np.empty(0)), np.empty(0), at(0.0, 1.0), candidates=2)
    np.testing.assert_array_equal(belief.mean, 0.3)
    assert (belief.variance > 0).all()


def test_a_planned_trial_lowers_the_variance_as_a_real_one_would():
    known, points = at(0.0), at(1.0, 3.0)
    planned = believe(known, np.array([0.4]), points, candidates=2).tried(0)
    gain = believe(known, np.array([0.4]), points, candidates=2)
    row = gain.covariance[0]
    np.testing.assert_allclose(planned.covariance, gain.covariance - np.outer(row, row) / (row[0] + gain.noise))
    assert (planned.variance < gain.variance).all()
    np.testing.assert_array_equal(planned.mean, gain.mean)


def test_the_expected_reduction_is_what_trying_brings():
    points = at(0.0, 1.0, 2.5, -1.0, 0.5)
    belief = believe(at(0.2), np.array([0.4]), points, candidates=2)
    gains = [float((belief.variance - belief.tried(index).variance)[2:].mean()) for index in range(2)]
    np.testing.assert_allclose(belief.reductions(), gains)


@pytest.mark.parametrize("acquisition", UNCERTAIN)
def test_what_repeats_known_trials_is_tried_after_what_is_new(acquisition: AcquisitionName):
    known = at(*[0.0] * 4, 0.1)
    belief = believe(known, np.full(5, 0.3), at(0.0, 1.5, 0.1), candidates=3)
    assert choose_next(belief, acquisition, count=3)[0] == 1


def test_two_alike_are_not_tried_one_after_the_other():
    belief = believe(at(0.0), np.array([0.3]), at(3.0, 3.0, -2.5), candidates=3)
    assert choose_next(belief, "variance", count=2) == [0, 2]


def test_the_lower_confidence_bound_prefers_where_the_model_may_be_applicable():
    certain = Belief(np.array([0.6, 0.2]), 0.01 * np.eye(2), noise=0.01, candidates=2)
    assert choose_next(certain, "lcb") == [1]
    unknown = Belief(np.array([0.6, 0.2]), np.diag([0.09, 0.0]), noise=0.01, candidates=2)
    assert choose_next(unknown, "lcb") == [0]  # 0.6 - 2 * 0.3 lies below 0.2


def test_what_the_robot_will_meet_decides():
    candidates, met = (-3.0, 3.0), (2.8, 3.2, 3.0)
    belief = believe(at(0.0), np.array([0.3]), at(*candidates, *met), candidates=2)
    assert choose_next(belief, "integrated") == [1]
    belief = believe(at(0.0), np.array([0.3]), at(*candidates, *(-place for place in met)), candidates=2)
    assert choose_next(belief, "integrated") == [0]


@pytest.mark.parametrize("acquisition", ACQUISITIONS)
def test_the_same_question_gets_the_same_choice_and_none_twice(acquisition: AcquisitionName):
    belief = believe(at(0.0, 0.4), np.array([0.3, 0.5]), at(*np.linspace(-2, 2, 9)), candidates=9)
    first, second = (choose_next(belief, acquisition, count=9, seed=4) for _ in range(2))
    assert first == second
    assert sorted(first) == list(range(9))


def test_random_choices_depend_on_the_seed():
    belief = believe(at(0.0), np.array([0.3]), at(*np.linspace(-2, 2, 40)), candidates=40)
    assert len({choose_next(belief, "random", seed=seed)[0] for seed in range(8)}) > 3


@pytest.mark.parametrize("count", [0, 3])
def test_more_than_there_is_cannot_be_chosen(count: int):
    belief = believe(at(0.0), np.array([0.3]), at(1.0, 2.0), candidates=2)
    with pytest.raises(RequestError, match=f"count: expected 1 to 2, the number of candidates, got {count}"):
        choose_next(belief, "random", count=count)


def test_descriptions_of_the_training_data_have_a_length_of_about_one(base: Calibrated, tmp_path: Path):
    dataset = write_dataset(tmp_path / "small")
    samples = dataset.samples("train")
    pairs = [
        (dataset.state("train", int(group)), samples.actions[samples.groups == group])
        for group in np.unique(samples.groups)
    ]
    points = points_of(base, "heuristic", pairs)
    assert points.described.shape == (32, 2 * 8)
    assert 0.3 < (points.described**2).sum(axis=1).mean() < 2


@pytest.mark.parametrize("acquisition", ["variance", "integrated"])
def test_a_pool_of_states_and_actions_is_chosen_from(base: Calibrated, acquisition: AcquisitionName):
    cases = make_trials(8)
    pairs = [(case.state, np.array([case.true_action])) for case in cases]
    known, novel = pairs[:4], pairs[4:]
    belief = belief_of(
        base, "heuristic", trials=3 * known, deviations=np.full(12, 0.3), candidates=[*known, *novel], reference=novel
    )
    assert len(belief.mean) == 12
    assert choose_next(belief, acquisition)[0] >= 4


def test_the_trusted_model_is_expected_to_be_right_before_any_trial(base: Calibrated):
    case = make_trials(1)[0]
    pair = case.state, np.array([case.true_action])
    belief = belief_of(base, "simulator", trials=[], deviations=np.empty(0), candidates=[pair])
    np.testing.assert_array_equal(belief.mean, 0.0)
