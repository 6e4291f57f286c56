"""Sweeps of cheap models."""

from dataclasses import replace

import numpy as np
import pytest
from planning_fakes import FakeEstimator, FakeModel, small_problem

from common.domain.errors import CancelledError, ModelError, RequestError
from common.planning.sweep import LARGEST_BATCH, Sweeps

PROBLEM = small_problem()
ACTIONS = np.random.default_rng(0).uniform(-0.05, 0.05, (150, 2))


def sweeps(*models: FakeModel, estimators: tuple[FakeEstimator, ...] = (), wait_for=lambda question: question()):
    return Sweeps(
        PROBLEM,
        {model.name: model for model in models},
        {estimator.model: estimator for estimator in estimators},
        now=lambda: 0.0,
        wait_for=wait_for,
    )


def test_a_sweep_gives_the_rewards_of_single_questions_in_batches_that_the_model_takes():
    model = FakeModel(name="heuristic")
    model.largest_batch = 40
    found = sweeps(model)
    rewards = found.rewards("heuristic", ACTIONS)
    single = np.concatenate([model.outcomes(PROBLEM.state, action[None])[0] for action in ACTIONS])
    expected = PROBLEM.task.reward(single, PROBLEM.target)
    np.testing.assert_allclose(rewards, expected, atol=1e-8)
    assert found.usage == {"heuristic": 150}
    assert found.versions == {"heuristic": "3"}


def test_a_batch_is_never_larger_than_a_message_should_be():
    model = FakeModel(name="heuristic")
    model.largest_batch = 4096
    sweeps(model).rewards("heuristic", ACTIONS)
    assert model.calls == -(-150 // LARGEST_BATCH)


def test_the_best_action_of_all_sweeps_is_kept_with_its_heightmap():
    model = FakeModel(name="heuristic")
    found = sweeps(model)
    first = found.rewards("heuristic", ACTIONS[:70])
    second = found.rewards("heuristic", ACTIONS[70:])
    assert first is not None
    assert second is not None
    both = np.concatenate([first, second])
    assert found.best is not None
    trial, heights = found.best
    assert trial.action == tuple(ACTIONS[int(both.argmax())])
    assert trial.reward == pytest.approx(both.max())
    assert float(PROBLEM.task.reward(heights, PROBLEM.target)) == pytest.approx(both.max())


def test_a_failing_model_or_mde_is_an_event():
    found = sweeps(
        FakeModel(name="heuristic", error=ModelError("bad")),
        estimators=(FakeEstimator(error=ModelError("bad too")),),
    )
    assert found.rewards("heuristic", ACTIONS) is None
    assert found.estimates("heuristic", ACTIONS) is None
    assert found.estimates("learned", ACTIONS) is None
    assert [(event.worker, event.detail) for event in found.events] == [
        ("heuristic", "bad"),
        ("mde/heuristic", "bad too"),
    ]


@pytest.mark.parametrize("error", [RequestError("refused"), CancelledError("gone")])
def test_what_every_model_would_meet_ends_the_sweep(error: Exception):
    with pytest.raises(type(error), match=str(error)):
        sweeps(FakeModel(name="heuristic", error=error)).rewards("heuristic", ACTIONS)


def test_estimates_of_parts_are_put_together():
    estimator = FakeEstimator(mean=lambda x: abs(x), margin=0.1)
    estimator.largest_batch = 60
    found = sweeps(FakeModel(name="heuristic"), estimators=(estimator,)).estimates("heuristic", ACTIONS)
    assert found is not None
    np.testing.assert_allclose(found.mean, np.abs(ACTIONS[:, 0]))
    np.testing.assert_allclose(found.upper, found.mean + 0.1)
    assert estimator.calls == 3


def test_a_state_that_an_mde_does_not_know_is_told_once():
    stranger = FakeEstimator(familiar=False)
    found = sweeps(FakeModel(name="heuristic"), estimators=(stranger,))
    for _ in range(2):
        found.estimates("heuristic", ACTIONS)
    assert [(event.kind, event.worker) for event in found.events] == [("unfamiliar", "mde/heuristic")]


def test_an_action_far_out_makes_no_state_unfamiliar():
    class NearOnly(FakeEstimator):
        def deviations(self, state, actions):
            return replace(super().deviations(state, actions), familiar=actions[:, 0] < 0.049)

    found = sweeps(FakeModel(name="heuristic"), estimators=(NearOnly(),))
    found.estimates("heuristic", ACTIONS)
    assert found.events == []
