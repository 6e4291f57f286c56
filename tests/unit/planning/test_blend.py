"""What several simulations say together."""

import numpy as np
import pytest
from numpy.typing import NDArray
from sklearn.gaussian_process import GaussianProcessRegressor
from sklearn.gaussian_process.kernels import ConstantKernel, Matern, WhiteKernel

from common.domain.transport import Transport, Window
from common.planning import blend as module
from common.planning.blend import Blend

SHAPE = (6, 8)
FIELD = np.random.default_rng(0).normal(0, 1, SHAPE)


class Still(Transport):
    """Knows one outcome, and that it stays what it is: all change has to come from the blend."""

    def __init__(self, action: NDArray[np.float64], outcome: NDArray[np.float64]) -> None:
        self.outcome = np.asarray(outcome, dtype=np.float32)
        self._action = action

    def window(self, actions: NDArray[np.float64]) -> Window:
        return slice(1, 5), slice(0, 8)

    def patches(self, actions: NDArray[np.float64], window: Window, shared: object = None) -> NDArray[np.float32]:
        return np.repeat(self.outcome[window][None], len(actions), axis=0)

    def distances(self, actions: NDArray[np.float64]) -> NDArray[np.float64]:
        return np.linalg.norm(actions - self._action, axis=1)

    def aligned(self) -> NDArray[np.float32]:
        return self.outcome[1:5].ravel()


def blend_of(actions: NDArray[np.float64], outcomes: NDArray[np.float64], target: NDArray[np.float64]) -> Blend:
    blend = Blend(target)
    for action, outcome in zip(actions, outcomes, strict=True):
        blend.add(action, Still(action, outcome))
    return blend


def trend(x: float) -> NDArray[np.float64]:
    """Return outcomes that change along x, by 0.5 mm a millimetre, in the window alone."""
    heights = np.zeros(SHAPE)
    heights[1:5] = 0.5 * x * np.sign(FIELD[1:5])
    return heights


def test_one_simulation_says_the_same_everywhere():
    blend = blend_of(np.zeros((1, 2)), FIELD[None] * 1e-3, np.zeros(SHAPE))
    mean, error = blend.predict(np.array([[0.0, 0.0], [0.003, 0.0]]))
    np.testing.assert_allclose(mean, -np.abs(FIELD).mean() * 1e-3, rtol=1e-6)
    assert error[0] < error[1]


def test_outcomes_on_either_side_meet_the_target_in_between():
    actions = np.array([[-1e-3, 0.0], [1e-3, 0.0]])
    blend = blend_of(actions, np.stack([trend(-1e-3), trend(1e-3)]), trend(0.0))
    mean, _ = blend.predict(np.array([[0.0, 0.0], *actions]))
    assert mean[0] == pytest.approx(0, abs=1e-6)
    assert max(mean[1:]) < -1e-4


def test_a_trend_goes_on_beyond_the_outcomes_that_show_it():
    actions = np.array([[-3e-3, 0.0], [-2e-3, 0.0], [-1e-3, 0.0]])
    blend = blend_of(actions, np.stack([trend(x) for x in actions[:, 0]]), trend(0.0))
    mean, _ = blend.predict(np.array([[0.0, 0.0], actions[-1]]))
    assert mean[0] > 0.6 * mean[1]


def test_it_is_the_gaussian_process_of_scikit_learn_with_an_unknown_mean(monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setattr(module, "LENGTHS", np.array([8e-3]))
    monkeypatch.setattr(module, "NOISES", np.array([1e-2]))
    rng = np.random.default_rng(1)
    actions, heights = rng.uniform(-5e-3, 5e-3, (4, 2)), rng.normal(0, 1e-3, 4)
    wanted = rng.uniform(-6e-3, 6e-3, (20, 2))
    blend = blend_of(actions, np.broadcast_to(heights[:, None, None], (4, *SHAPE)), np.full(SHAPE, -1.0))
    kernel = ConstantKernel(1e4, "fixed") + Matern(8e-3, "fixed", nu=2.5) + WhiteKernel(1e-2, "fixed")
    reference = GaussianProcessRegressor(kernel, optimizer=None).fit(actions, heights).predict(wanted)
    found = -np.array([blend.predict(action[None])[0][0] for action in wanted]) - 1
    # Outside the window it is the weightiest outcome.
    share = 4 / 6
    rest = np.array([heights[np.argmax(np.abs(blend._weights(blend._distances(a[None]))[0]))] for a in wanted])
    np.testing.assert_allclose(found, share * reference + (1 - share) * rest, atol=2e-7)


def test_surprises_widen_the_error_and_confirmations_narrow_it():
    action, near = np.zeros(2), np.array([5e-4, 0.0])

    def error(off: float) -> float:
        blend = blend_of(action[None], FIELD[None] * 1e-3, np.zeros(SHAPE))
        mean, said = blend.predict(near[None])
        blend.compare(near, float(mean[0] + off * said[0]))
        return float(blend.predict(near[None])[1][0] / said[0])

    assert error(0.0) == pytest.approx(np.sqrt(2 / 3))
    assert error(1.0) == pytest.approx(1.0)
    assert error(5.0) == pytest.approx(np.sqrt(27 / 3))
    assert error(500.0) == error(6.0)


def test_a_surface_that_changes_at_random_is_less_certain_than_one_that_stays():
    rng = np.random.default_rng(2)
    actions = rng.uniform(-2e-3, 2e-3, (5, 2))
    same = blend_of(actions, np.repeat(FIELD[None] * 1e-3, 5, axis=0), np.zeros(SHAPE))
    rough = blend_of(actions, 1e-3 * rng.normal(0, 1, (5, *SHAPE)), np.zeros(SHAPE))
    wanted = np.array([[1e-3, 1e-3]])
    assert rough.predict(wanted)[1][0] > 2 * same.predict(wanted)[1][0]


def test_an_outcome_takes_the_place_of_one_that_was_known_for_the_action():
    action = np.array([1e-3, 2e-3])
    blend = blend_of(np.stack([action, action]), np.stack([FIELD * 1e-3, trend(1e-3)]), trend(1e-3))
    assert len(blend) == 1
    assert blend.predict(action[None])[0][0] == pytest.approx(0, abs=1e-9)


def test_it_forgets_those_that_are_far_away_when_there_are_many():
    actions = np.array([[5e-2, 0.0], *([1e-4 * index, 0.0] for index in range(40))])
    blend = blend_of(actions, np.stack([FIELD * 1e-3, *(trend(1e-4 * index) for index in range(40))]), trend(3.9e-3))
    assert len(blend) == module.KEPT
    assert blend.nearest(actions[:1])[0] > 4e-2
    assert blend.nearest(actions[-1:])[0] == 0


def test_an_action_belongs_to_the_simulation_nearest_to_it():
    actions = np.array([[0.0, 0.0], [5e-2, 0.0], [0.0, 5e-2]])
    blend = blend_of(actions, np.repeat(FIELD[None], 3, axis=0), np.zeros(SHAPE))
    assert blend.owners(actions[[2, 0, 1]] + 1e-3).tolist() == [2, 0, 1]
