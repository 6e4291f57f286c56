"""Whether certificates hold: raw results and what they say."""

import json
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from common.domain.deviation import Estimates
from common.planning.certificate import FACTORS, PROBABILITY
from pipelines.evaluate.certificate import certificate_table, run_certificate, true_gains
from pipelines.evaluate.threshold import Equipment
from services.heuristic import HeuristicModel
from tests.fakes import Radius
from tests.mde_fakes import Sinking
from tests.unit.pipelines.test_strategies_evaluation import a_case


class Scaled(Radius):
    """Says what its estimates mean in metres."""

    def deviations(self, state, actions) -> Estimates:
        return replace(super().deviations(state, actions), scale_m=2e-3)


TOOLS = Equipment({"heuristic": HeuristicModel(), "simulator": Sinking()}, {"heuristic": Scaled("heuristic")})


@pytest.fixture(scope="module")
def records() -> list[dict[str, Any]]:
    return [json.loads(json.dumps(run_certificate(a_case(index), index, TOOLS, calls=3))) for index in range(2)]


def test_every_action_of_the_grid_is_simulated_and_every_call_kept(records: list[dict[str, Any]]):
    for index, record in enumerate(records):
        case = a_case(index)
        assert len(record["actions"]) == len(record["path"]) == 3
        assert len(record["grid"]) == len(record["grid_rewards"]) > 49
        heights = Sinking().predict(case.state, np.array(record["grid"][:3])).heights
        true = -np.abs(heights.astype(float) - case.target).mean(axis=(1, 2))
        np.testing.assert_allclose(record["grid_rewards"][:3], true, atol=1e-9)
        stated = [FACTORS["heuristic"] * step["slack_m"] / n for n, step in enumerate(record["path"], start=1)]
        np.testing.assert_allclose([step["gain_m"] for step in record["path"]], stated)


def a_record(target: int, rewards: list[float], grid: list[float], slack_m: float | None) -> dict[str, Any]:
    path = [{"reward": reward, "slack_m": slack_m, "left": 0.5, "gain_m": None} for reward in rewards]
    return {"target": target, "model": "heuristic", "path": path, "grid_rewards": grid}


def test_true_gains_are_measured_from_the_best_reward_so_far():
    record = a_record(0, [-3e-3, -1e-3, -2e-3], [-0.5e-3, -4e-3], 1e-3)
    np.testing.assert_allclose(true_gains(record), [2.5e-3, 0.5e-3, 0.5e-3])
    assert true_gains(a_record(0, [-1e-3], [-2e-3], 1e-3)) == [0]


def test_a_violation_is_a_true_gain_beyond_the_stated_one():
    factor = FACTORS["heuristic"]
    just, beyond = 0.99 * factor * 1e-3, 1.01 * factor * 1e-3
    good = [a_record(n, [-0.1], [-0.1 + just], 1e-3) for n in range(3)]
    table = certificate_table([*good, a_record(3, [-0.1], [-0.1 + beyond], 1e-3)], [1])
    assert table["anywhere"] == table["rows"][0]["violated"] == 0.25
    assert table["rows"][0]["gain_mean_m"] == pytest.approx(factor * 1e-3)
    assert table["probability"] == PROBABILITY
    assert table["factors_needed"] == {"heuristic": None}  # four targets are too few


def test_the_needed_factor_is_one_with_which_nine_in_ten_would_have_held():
    gains = np.linspace(1e-5, 4e-4, 20)
    table = certificate_table([a_record(n, [-0.1], [-0.1 + gain], 1e-3) for n, gain in enumerate(gains)], [1])
    assert table["factors_needed"]["heuristic"] == pytest.approx(gains[18] / 1e-3)


def test_targets_without_a_certificate_are_counted_and_left_out():
    table = certificate_table([a_record(0, [-0.1], [-0.05], None)], [1])
    assert (table["targets"], table["certified"], table["anywhere"], table["rows"]) == (1, 0, None, [])
