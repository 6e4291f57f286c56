"""Optimisations of held-out targets: raw results that can be gone on with, and what they say."""

import json
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from common.domain.errors import RequestError
from common.storage.dataset import Dataset
from pipelines.evaluate.targets import held_out_target
from pipelines.evaluate.threshold import Equipment, Method, Plan, read_records, run, run_target
from pipelines.evaluate.threshold_table import stopped, threshold_table
from services.heuristic import HeuristicModel
from tests.fakes import Radius
from tests.mde_fakes import Sinking, write_dataset

METHODS = (Method("only:simulator"), Method("threshold", 0.4), Method("only:heuristic"))
PLAN = Plan(targets=4, seed=3, evaluations=8, methods=METHODS)
TOOLS = Equipment({"heuristic": HeuristicModel(), "simulator": Sinking()}, {"heuristic": Radius("heuristic")})
ABOUT = {"dataset": "small"}


@pytest.fixture(scope="module")
def dataset(tmp_path_factory: pytest.TempPathFactory) -> Dataset:
    return write_dataset(tmp_path_factory.mktemp("data") / "small")


class Work:
    """Runs one target and counts; fails at one of them if told to."""

    def __init__(self, dataset: Dataset, *, fails_at: int | None = None) -> None:
        self.dataset, self.fails_at = dataset, fails_at
        self.samples = dataset.samples("test")
        self.asked: list[tuple[int, frozenset[str]]] = []

    def __call__(self, index: int, done: set[str]) -> Sequence[dict[str, Any]]:
        if index == self.fails_at:
            raise KeyboardInterrupt
        self.asked.append((index, frozenset(done)))
        case = held_out_target(self.dataset, self.samples, index, seed=PLAN.seed, simulator=Sinking())
        return list(run_target(case, index, PLAN, TOOLS, done))


@pytest.fixture(scope="module")
def finished(dataset: Dataset, tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("results") / "trials.jsonl"
    run(path, PLAN, ABOUT, Work(dataset))
    return path


def without_times(records: Sequence[dict[str, Any]]) -> list[tuple[Any, ...]]:
    return [(one["target"], one["method"], one["action"], one["true_reward"], one["usage"]) for one in records]


def test_even_targets_are_outcomes_of_the_test_split_and_odd_ones_come_from_another_item(dataset: Dataset):
    samples = dataset.samples("test")
    cases = [held_out_target(dataset, samples, index, seed=0, simulator=Sinking()) for index in range(4)]
    assert [case.same_item for case in cases] == [True, False, True, False]
    np.testing.assert_array_equal(cases[0].target, samples.outcomes[0])
    assert cases[0].reference_action == tuple(samples.actions[0])
    assert cases[1].reference_action is None
    again = held_out_target(dataset, samples, 1, seed=0, simulator=Sinking())
    np.testing.assert_array_equal(again.target, cases[1].target)


def test_every_method_optimises_every_target_once(finished: Path):
    experiment, records = read_records(finished)
    assert experiment["dataset"] == "small"
    assert [(one["target"], one["method"]) for one in records] == [
        (target, method) for target in range(4) for method in ("only:simulator", "threshold 0.4", "only:heuristic")
    ]
    for one in records:
        assert len(one["trials"]) == 8
        assert (one["action_error_m"] is None) == (one["target"] % 2 == 1)


def test_the_true_reward_is_the_simulator_s(finished: Path, dataset: Dataset):
    _, records = read_records(finished)
    record = records[2]
    assert record["usage"] == {"heuristic": 8}
    case = held_out_target(dataset, dataset.samples("test"), 0, seed=PLAN.seed, simulator=Sinking())
    heights = Sinking().predict(case.state, np.array([record["action"]])).heights[0]
    assert record["true_reward"] == pytest.approx(-float(np.abs(heights - case.target).mean()), rel=1e-5)
    assert record["true_reward"] != record["reward"]


def test_an_interrupted_run_is_gone_on_with_and_gives_the_same(dataset: Dataset, finished: Path, tmp_path: Path):
    path = tmp_path / "trials.jsonl"
    with pytest.raises(KeyboardInterrupt):
        run(path, PLAN, ABOUT, Work(dataset, fails_at=2))
    with path.open("a") as file:
        file.write('{"target": 2, "method": "only:sim')  # cut off in the middle of a line
    work = Work(dataset)
    run(path, PLAN, ABOUT, work)
    assert [index for index, _ in work.asked] == [2, 3]
    assert without_times(read_records(path)[1]) == without_times(read_records(finished)[1])


def test_another_experiment_is_not_mixed_in(dataset: Dataset, finished: Path):
    with pytest.raises(RequestError, match="evaluations differ"):
        run(finished, Plan(4, seed=3, evaluations=9, methods=METHODS), ABOUT, Work(dataset))
    with pytest.raises(RequestError, match="dataset differ"):
        run(finished, PLAN, {"dataset": "other"}, Work(dataset))


def test_a_file_that_is_something_else_is_refused(tmp_path: Path):
    (tmp_path / "trials.jsonl").write_text("{}\n{}\n")
    with pytest.raises(RequestError, match="expected an experiment in the first line"):
        read_records(tmp_path / "trials.jsonl")


def test_the_table_says_what_the_records_do(finished: Path):
    table = json.loads(json.dumps(threshold_table(read_records(finished)[1])))
    assert set(table) == {"only:simulator", "threshold 0.4", "threshold 0.4, calls", "only:heuristic"}
    alone = table["only:simulator"]
    assert (alone["targets"], alone["same_item_targets"], alone["simulator_calls"]) == (4, 2, 8.0)
    assert alone["shares"] == {"simulator": 1.0}
    assert alone["time_ratio"] == 1.0
    assert set(alone["action_error_m"]) == {"mean", "median", "p90"}
    mixed = table["threshold 0.4"]
    assert sum(mixed["shares"].values()) == pytest.approx(1)
    assert mixed["simulator_calls"] == pytest.approx(8 * mixed["shares"]["simulator"])
    assert min(figures["regret_same_item_m"]["median"] for figures in table.values()) >= 0


def test_the_simulator_stopped_early_answers_with_the_best_of_its_first_calls():
    trials = [
        {"action": [0.0, 0.01], "reward": -3.0, "compute_s": 1.0, "started_s": 0.0, "predict_s": 1.0},
        {"action": [0.0, 0.0], "reward": -1.0, "compute_s": 1.0, "started_s": 1.5, "predict_s": 1.0},
        {"action": [0.0, 0.03], "reward": -0.5, "compute_s": 1.0, "started_s": 3.0, "predict_s": 1.0},
    ]
    record = {
        "action_error_m": 0.5, "true_action": [0.0, 0.02], "true_reward": -0.5, "split_s": {"simulator": 3.0},
        "trials": trials,
    }  # fmt: skip
    early = stopped(record, 2)
    assert (early["true_reward"], early["action"], early["wall_s"]) == (-1.0, [0.0, 0.0], 2.5)
    assert early["action_error_m"] == pytest.approx(0.02)
    assert stopped(record, 0)["true_reward"] == -3.0
    assert stopped(record, 3)["true_reward"] == -0.5
