"""Strategies side by side: raw results and what they say."""

import json
import sys
import time
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from common.domain.case import Case
from common.domain.deviation import Estimates
from common.domain.errors import ModelError, RequestError
from common.domain.grid import Floats
from common.domain.scene import State
from common.planning.optimize import optimize
from common.planning.problem import Problem
from common.tasks import TASKS
from pipelines.evaluate.strategies import JITTER_M, Comparison, Kit, make_plan, run_strategies
from pipelines.evaluate.strategies_controls import Scaling
from pipelines.evaluate.strategies_methods import SETS, make_strategy, parse_contender
from pipelines.evaluate.strategies_table import strategies_table
from pipelines.evaluate.threshold import read_records, run
from pipelines.optimizers import botorch_fidelities
from services.heuristic import HeuristicModel
from tests.fakes import Radius, make_state
from tests.mde_fakes import Sinking

REFERENCE = "only:simulator"
OURS = "transport:calls=2"
NAMES = (OURS, f"{OURS}+oracle-mde", "polish:calls=2", "threshold", "threshold+d_max=0.9")
PLAN = make_plan(4, NAMES, evaluations=5)
SCALING = Scaling(scale_m=4e-3, mean=0.3)


class Counting(Sinking):
    """Counts the actions that it simulates; takes its time over each, more over the first of a state."""

    def __init__(self, *, fails_at: int | None = None) -> None:
        self.simulated: list[bytes] = []
        self.states: set[str] = set()
        self.fails_at = fails_at

    def outcomes(self, state: State, actions: NDArray[np.float64]) -> tuple[Floats, tuple[str, ...]]:
        self.simulated += [action.tobytes() for action in actions]
        if self.fails_at is not None and len(self.simulated) > self.fails_at:
            raise ModelError("the solver diverged")
        _compute(0.004 if state.digest in self.states else 0.024)
        self.states.add(state.digest)
        return super().outcomes(state, actions)


def _compute(seconds: float) -> None:
    ends = time.process_time() + seconds
    while time.process_time() < ends:
        pass


def a_kit(simulator: Sinking | None = None) -> Kit:
    models = {"heuristic": HeuristicModel(), "simulator": simulator or Sinking()}
    return Kit(
        models,
        {"heuristic": Radius("heuristic")},
        {"heuristic": SCALING},
        trusted="simulator",
        make_trusted=Sinking,
    )


def a_case(index: int) -> Case:
    state, action = make_state(index), (0.01 * index - 0.01, 0.012)
    target = Sinking().predict(state, np.array([action])).heights[0]
    return Case(f"case-{index}", index, state, target, action, index % 2 == 0)


def results(plan: Comparison, path: Path, kit: Kit) -> list[dict[str, Any]]:
    run(path, plan, {}, lambda index, done: list(run_strategies(a_case(index), index, plan, kit, done)))
    return read_records(path)[1]


@pytest.fixture(scope="module")
def records(tmp_path_factory: pytest.TempPathFactory) -> list[dict[str, Any]]:
    return results(PLAN, tmp_path_factory.mktemp("results") / "development.jsonl", a_kit())


@pytest.fixture(scope="module")
def rows(records: list[dict[str, Any]]) -> dict[str, dict[str, Any]]:
    return {row["strategy"]: row for row in json.loads(json.dumps(strategies_table(records)))}


def test_every_method_runs_once_on_every_target_and_another_one_begins_each_time(records: list[dict[str, Any]]):
    names = [REFERENCE, *NAMES]
    expected = [(i, name) for i in range(4) for name in names[i:] + names[:i]]
    assert [(one["target"], one["method"]) for one in records] == expected
    for one in records:
        assert one["process_s"] > 0
        assert one["calls"] <= (2 if "calls=2" in one["method"] else 5)


def test_a_row_holds_every_figure_with_its_interval_and_the_paired_difference(rows: dict[str, dict[str, Any]]):
    assert f"{REFERENCE}, 3 calls" in rows
    for row in rows.values():
        for name in ("error_median_m", "error_mean_m", "reward_regret_m", "simulator_calls", "wall_s"):
            figure = row[name]
            assert figure["low"] <= figure["value"] <= figure["high"]
            assert figure["difference_low"] <= figure["difference"] <= figure["difference_high"]
    reference = rows[REFERENCE]
    assert reference["error_mean_m"]["difference"] == 0
    assert reference["wall_s"]["ratio"] == 1
    assert reference["simulator_calls"]["value"] == 5
    assert rows[f"{REFERENCE}, 3 calls"]["simulator_calls"]["value"] == 3
    assert rows[OURS]["simulator_calls"]["difference"] == -3
    assert rows[OURS]["simulator_calls"]["ratio"] == pytest.approx(0.4)


def test_the_errors_are_those_of_targets_made_with_the_own_item(
    records: list[dict[str, Any]], rows: dict[str, dict[str, Any]]
):
    errors = [one["action_error_m"] for one in records if one["method"] == OURS and one["action_error_m"] is not None]
    assert len(errors) == 2
    assert rows[OURS]["error_mean_m"]["value"] == pytest.approx(np.mean(errors))


def test_each_method_is_compared_with_the_reference_stopped_at_as_many_calls_with_the_polish_and_with_other_mdes(
    records: list[dict[str, Any]], rows: dict[str, dict[str, Any]]
):
    against = rows[OURS]["against"]
    assert set(against) == {"stopped", "polish:calls=2", f"{OURS}+oracle-mde", "threshold"}
    assert OURS in rows[f"{OURS}+oracle-mde"]["against"]
    stopped = [max(trial["reward"] for trial in one["trials"][:2]) for one in records if one["method"] == REFERENCE]
    own = [one["true_reward"] for one in records if one["method"] == OURS]
    difference = against["stopped"]["reward_regret_m"]["difference"]
    assert difference == pytest.approx(np.mean(stopped) - np.mean(own))
    assert against["stopped"]["simulator_calls"]["difference"] == 0


def test_the_reward_under_jitter_is_the_mean_over_the_same_execution_errors(records: list[dict[str, Any]]):
    (one,) = [one for one in records if one["method"] == OURS and one["target"] == 1]
    half = np.random.default_rng([0, 1]).normal(0, JITTER_M, (2, 2))
    case = a_case(1)
    actions = np.array(one["action"]) + np.concatenate([half, -half])
    rewards = [
        -np.abs(Sinking().predict(case.state, action[None]).heights[0] - case.target).mean() for action in actions
    ]
    assert one["jitter_reward"] == pytest.approx(np.mean(rewards), rel=1e-5)


def test_no_action_of_a_target_is_simulated_twice_and_every_method_pays_for_its_own_calls_and_the_preparation():
    simulator, plan = Counting(), make_plan(2, (OURS, f"{OURS}+oracle-mde", "residual:calls=2"), evaluations=5)
    found = list(run_strategies(a_case(0), 0, plan, a_kit(simulator), set()))
    repeated = len(simulator.simulated) - len(set(simulator.simulated))
    assert repeated == 1  # the two calls that measure the preparation
    for one in found:
        least = 0.004 * one["calls"] + 0.015
        assert one["process_s"] > least
        assert one["wall_s"] > least
        assert one["split_s"]["simulator"] > least
    cheap, oracle = found[1], found[2]
    assert cheap["calls"] == oracle["calls"] == 2
    assert oracle["process_s"] < cheap["process_s"] + 0.03  # nobody pays for what the oracle simulates


def test_a_method_that_fails_is_recorded_and_leaves_the_target_out(tmp_path: Path):
    plan = make_plan(2, ("only:heuristic",), evaluations=5)
    kit = a_kit(Counting(fails_at=10))
    found = results(plan, tmp_path / "results.jsonl", kit)
    errors = [one for one in found if "error" in one]
    assert [(one["target"], one["method"]) for one in errors] == [(1, REFERENCE)]
    assert "the solver diverged" in errors[0]["error"]
    (row, *_) = strategies_table(found)
    assert (row["targets"], row["failed"]) == (1, 1)


def test_a_run_that_was_interrupted_goes_on_where_it_was(records: list[dict[str, Any]], tmp_path: Path):
    path = tmp_path / "results.jsonl"
    results(PLAN, path, a_kit())
    lines = path.read_text().splitlines()
    path.write_text("\n".join(lines[:9]) + '\n{"target"')
    again = results(PLAN, path, a_kit())
    key = [(one["target"], one["method"], one["action"]) for one in records]
    assert sorted((one["target"], one["method"], one["action"]) for one in again) == sorted(key)


def test_a_violated_certificate_is_one_where_a_better_action_is_known_than_it_allows(records: list[dict[str, Any]]):
    certificate = {"gain": 1e-5, "probability": 0.9}
    told = [
        {**one, "certificate": certificate, "true_reward": one["true_reward"] - (2e-5 if one["target"] == 3 else 0.0)}
        if one["method"] == REFERENCE
        else {**one, "true_reward": -1.0}
        for one in records
    ]
    better = [{**one, "method": "better", "certificate": None} for one in told if one["method"] == REFERENCE]
    for one in better:
        one["true_reward"] += 2e-5 if one["target"] == 3 else 0.0
    row = strategies_table([*told, *better])[0]
    assert row["certificate"]["violated"] == 0.25
    assert row["certificate"]["stated"] == pytest.approx(0.1)


def test_the_constant_mde_knows_nothing_and_the_oracle_everything():
    case, kit = a_case(0), a_kit()
    problem = Problem(TASKS["plating"], case.state, case.target)
    actions = np.array([[0.0, 0.0], [0.02, -0.01]])
    found = {}
    for control in ("constant-mde", "oracle-mde"):
        with kit.run(parse_contender(f"threshold+{control}", trusted="simulator"), problem) as one:
            found[control] = one.estimators["heuristic"].estimate(case.state, actions)
    assert found["constant-mde"].mean.tolist() == [SCALING.mean] * 2
    fast, true = (model.predict(case.state, actions).heights for model in (HeuristicModel(), Sinking()))
    expected = np.clip(np.abs(fast - true).mean(axis=(1, 2)) / SCALING.scale_m, 0, 1)
    np.testing.assert_allclose(found["oracle-mde"].mean, expected, rtol=1e-5)


def test_with_two_in_flight_two_processes_find_what_one_finds():
    plan = make_plan(2, (f"{REFERENCE}+2-in-flight",), evaluations=4, jitter=0)
    kit = a_kit()
    try:
        alone, two = run_strategies(a_case(0), 0, plan, kit, set())
    finally:
        kit.close()
    assert two["calls"] == alone["calls"] == 4
    assert two["jitter_reward"] is None
    assert [trial["action"] for trial in two["trials"][:4]] == [trial["action"] for trial in alone["trials"][:4]]
    assert two["process_s"] > 0


def test_another_level_can_be_trusted():
    fine = Sinking()
    fine.name = "simulator_fine"
    kit = Kit(
        {"heuristic": HeuristicModel(), "simulator": Sinking(), "simulator_fine": fine},
        {},
        {},
        trusted="simulator_fine",
        make_trusted=Sinking,
    )
    plan = make_plan(2, (OURS,), evaluations=4, trusted="simulator_fine")
    found = list(run_strategies(a_case(0), 0, plan, kit, set()))
    assert [one["method"] for one in found] == ["only:simulator_fine", OURS]
    assert [one["calls"] for one in found] == [4, 1]  # the other level, which agrees, was optimised before
    assert found[1]["usage"]["simulator"] == 2
    assert found[1]["usage"].keys() >= {"heuristic", "simulator_fine"}
    assert {row["strategy"] for row in strategies_table(found, trusted="simulator_fine")} >= {"only:simulator_fine"}


@pytest.mark.parametrize("name", ["botorch:ucb", "botorch:logei"])
def test_botorch_begins_with_the_same_actions_and_finds_the_target(name: str):
    case = a_case(0)
    problem = Problem(TASKS["plating"], case.state, case.target)
    found, ours = (
        optimize(
            problem, {"simulator": Sinking()}, {}, strategy=make_strategy(each, trusted="simulator"), evaluations=12
        )
        for each in (name, REFERENCE)
    )
    assert [trial.action for trial in found.trials[:6]] == [trial.action for trial in ours.trials[:6]]
    assert len({trial.action for trial in found.trials}) == 12
    assert found.reward > max(trial.reward or -1.0 for trial in found.trials[:6])


def test_botorchs_fidelities_ask_cheap_models_and_answer_with_a_simulated_action(monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setattr(botorch_fidelities, "FANTASIES", 4)
    monkeypatch.setattr(botorch_fidelities.FidelityPlan, "MOST", 8)
    case = a_case(0)
    strategy = make_strategy("botorch:mfkg:calls=3", trusted="simulator", costs={"heuristic": 0.001, "simulator": 0.1})
    models = {"heuristic": HeuristicModel(), "simulator": Sinking()}
    result = optimize(Problem(TASKS["plating"], case.state, case.target), models, {}, strategy=strategy)
    assert [trial.model for trial in result.trials] == ["simulator"] * 3
    assert result.usage["heuristic"] >= botorch_fidelities.FIRST
    assert len({trial.action for trial in result.trials}) == 3


def test_without_botorch_an_error_says_what_to_install(monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setitem(sys.modules, "botorch", None)
    with pytest.raises(RequestError, match="pip install"):
        parse_contender("botorch:logei", trusted="simulator")


def test_execution_errors_come_in_pairs():
    with pytest.raises(RequestError, match=r"even number, .* got 3"):
        make_plan(2, (), evaluations=5, jitter=3)


def test_every_named_set_exists_and_holds_the_strategies_of_the_paper_and_ours():
    for make in SETS.values():
        for name in make("simulator"):
            assert parse_contender(name, trusted="simulator").label == name
    assert {REFERENCE, "fast", "balanced", "quality", "threshold"} <= set(SETS["main"]("simulator"))


@pytest.mark.parametrize(
    "name",
    [
        "best",
        "quality+perfect-mde",
        "threshold+d_max=1.5",
        "threshold+d_max=0",
        "quality+0-in-flight",
        "botorch:ei",
        "polish",
        "polish:calls=0",
        "botorch:ucb+2-in-flight",
        "quality+oracle-mde+2-in-flight",
    ],
)
def test_an_unknown_strategy_or_option_is_refused(name: str):
    with pytest.raises(RequestError, match="expected"):
        make_plan(2, (name,), evaluations=5)


class Doubting(Radius):
    """Knows no input."""

    def deviations(self, state: State, actions: NDArray[np.float64]) -> Estimates:
        found = super().deviations(state, actions)
        return replace(found, familiar=np.zeros(len(actions), dtype=bool), reason="never seen")


def test_a_trusting_method_uses_an_mde_that_doubts():
    kit = Kit(
        {"heuristic": HeuristicModel(), "simulator": Sinking()},
        {"heuristic": Doubting("heuristic")},
        {"heuristic": SCALING},
        trusted="simulator",
        make_trusted=Sinking,
    )
    plan = make_plan(1, ("threshold+d_max=1", "threshold+d_max=1+trusting"), evaluations=5)
    found = {row["method"]: row for row in run_strategies(a_case(0), 0, plan, kit, set())}
    assert set(found["threshold+d_max=1"]["usage"]) == {"simulator"}
    assert found["threshold+d_max=1"]["unfamiliar"] == 5
    assert set(found["threshold+d_max=1+trusting"]["usage"]) == {"heuristic"}
    assert found["threshold+d_max=1+trusting"]["unfamiliar"] == 0
