"""Strategies side by side: raw results and what they say."""

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from common.domain.case import Case
from common.domain.errors import RequestError
from common.planning.selection import parse_strategy
from pipelines.evaluate.strategies import REFERENCE, STRATEGIES, make_plan, run_strategies
from pipelines.evaluate.strategies_controls import CONTROLS, SCALE, TRAINING_MEAN
from pipelines.evaluate.strategies_table import strategies_table
from pipelines.evaluate.threshold import Equipment, read_records, run
from services.heuristic import HeuristicModel
from tests.fakes import Radius, make_state
from tests.mde_fakes import Sinking

TOOLS = Equipment({"heuristic": HeuristicModel(), "simulator": Sinking()}, {"heuristic": Radius("heuristic")})
PLAN = make_plan(4, ("transport:calls=2", "transport:calls=2+oracle-mde", "threshold"), evaluations=5)


def a_case(index: int) -> Case:
    state, action = make_state(index), (0.01 * index - 0.01, 0.012)
    target = Sinking().predict(state, np.array([action])).heights[0]
    return Case(f"case-{index}", index, state, target, action, index % 2 == 0)


@pytest.fixture(scope="module")
def records(tmp_path_factory: pytest.TempPathFactory) -> list[dict[str, Any]]:
    path: Path = tmp_path_factory.mktemp("results") / "development.jsonl"
    run(path, PLAN, {}, lambda index, done: list(run_strategies(a_case(index), index, PLAN, TOOLS, done)))
    return read_records(path)[1]


def test_every_strategy_runs_on_the_same_targets_as_the_reference(records: list[dict[str, Any]]):
    methods = [REFERENCE, "transport:calls=2", "transport:calls=2+oracle-mde", "threshold 0.4"]
    assert [(one["target"], one["method"]) for one in records] == [(i, name) for i in range(4) for name in methods]
    for one in records:
        assert one["process_s"] > 0
        assert one["usage"].get("simulator", 0) <= (2 if one["method"].startswith("transport") else 5)


def test_a_row_holds_every_figure_with_its_interval_and_the_paired_difference(records: list[dict[str, Any]]):
    rows = {row["strategy"]: row for row in json.loads(json.dumps(strategies_table(records)))}
    assert {f"{REFERENCE}, {calls} calls" for calls in (3, 6, 12)} < set(rows)
    for row in rows.values():
        for name in ("error_median_m", "error_mean_m", "reward_regret_m", "simulator_calls", "wall_s"):
            figure = row[name]
            assert figure["low"] <= figure["value"] <= figure["high"]
            assert figure["difference_low"] <= figure["difference"] <= figure["difference_high"]
    reference = rows[REFERENCE]
    assert reference["error_mean_m"]["difference"] == 0
    assert reference["simulator_calls"]["value"] == 5
    assert rows[f"{REFERENCE}, 3 calls"]["simulator_calls"]["value"] == 3
    assert rows["transport:calls=2"]["simulator_calls"]["difference"] == -3


def test_the_errors_are_those_of_targets_made_with_the_own_item(records: list[dict[str, Any]]):
    (row,) = [row for row in strategies_table(records) if row["strategy"] == "transport:calls=2"]
    errors = [
        one["action_error_m"]
        for one in records
        if one["method"] == "transport:calls=2" and one["action_error_m"] is not None
    ]
    assert len(errors) == 2
    assert row["error_mean_m"]["value"] == pytest.approx(np.mean(errors))


def test_the_constant_mde_knows_nothing_and_the_oracle_everything():
    state, actions = make_state(), np.array([[0.0, 0.0], [0.02, -0.01]])
    fast, simulator = TOOLS.models["heuristic"], TOOLS.models["simulator"]
    constant, oracle = (
        CONTROLS[name](TOOLS.estimators["heuristic"], fast, simulator) for name in ("constant-mde", "oracle-mde")
    )
    assert constant.estimate(state, actions).mean.tolist() == [TRAINING_MEAN] * 2
    assert constant.model == oracle.model == "heuristic"
    true = np.abs(fast.predict(state, actions).heights - simulator.predict(state, actions).heights).mean(axis=(1, 2))
    np.testing.assert_allclose(oracle.estimate(state, actions).mean, np.clip(true / SCALE, 0, 1), rtol=1e-5)


def test_what_is_compared_by_default_exists():
    for name in STRATEGIES:
        assert parse_strategy(name).name == name
    assert STRATEGIES[0] == REFERENCE


@pytest.mark.parametrize("name", ["best", "quality+perfect-mde"])
def test_an_unknown_strategy_or_control_is_refused(name: str):
    with pytest.raises(RequestError, match="expected one of"):
        make_plan(2, (name,), evaluations=5)
