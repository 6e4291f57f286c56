"""Table II: from a data set to the figures."""

import json
from pathlib import Path

import numpy as np
import pytest

from common.storage.dataset import Dataset
from common.tasks import TASKS
from pipelines.evaluate.accept_maps import accept_maps, read_map, write_map
from pipelines.evaluate.mdes import mdes_table
from pipelines.evaluate.mdes_figures import draw_accept_maps, draw_reliability
from pipelines.evaluate.mdes_runs import Judgement, Run, find_weights, judge, read_runs, write_runs
from pipelines.figures import save_figure
from pipelines.mde.examples import deviation_scale
from pipelines.mde.subject import Subject
from services.heuristic import HeuristicModel
from services.mde.estimator import read_estimator
from tests.mde_fakes import Sinking, small_settings, write_dataset

KEYS = {"mae", "mae_std", "median_baseline_mae", "spearman", "auroc", "false_accept_rate", "bad_share", "recall"}
KEYS |= {"coverage", "nominal_coverage", "d_max", "seeds", "samples", "within", "accepted", "action_s", "state_s"}


@pytest.fixture(scope="module")
def dataset(tmp_path_factory: pytest.TempPathFactory) -> Dataset:
    return write_dataset(tmp_path_factory.mktemp("data") / "small")


@pytest.fixture(scope="module")
def subject(dataset: Dataset) -> Subject:
    return Subject.predicting(dataset, HeuristicModel())


@pytest.fixture(scope="module")
def work(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("work")


@pytest.fixture(scope="module")
def runs(dataset: Dataset, subject: Subject, work: Path) -> tuple[Run, ...]:
    found = []
    for variant, members in (("crop", 2), ("paper", 1)):
        for seed in range(2):
            folder = find_weights(
                dataset,
                subject,
                small_settings(variant, members=members, epochs=1, seed=seed),
                scale_m=deviation_scale(dataset),
                released=work / "none",
                work=work,
            )
            found.append(judge(dataset, subject, folder))
    return tuple(found)


def test_every_test_sample_is_judged_once_by_every_seed_of_every_variant(runs: tuple[Run, ...]):
    for run in runs:
        assert [one.sample for one in run.judgements] == list(range(8))
    assert {(run.judgements[0].variant, run.judgements[0].seed) for run in runs} == {
        ("crop", 0), ("crop", 1), ("paper", 0), ("paper", 1)
    }  # fmt: skip
    assert all(run.action_s > 0 and run.state_s > 0 for run in runs)


def test_weights_that_are_there_are_not_trained_again(dataset: Dataset, subject: Subject, work: Path, runs):
    def fail(member, epoch):
        raise AssertionError("trained again")

    same = {"scale_m": deviation_scale(dataset), "work": work / "other", "report": fail}
    folder = work / "mde_heuristic-crop-1"
    found = find_weights(dataset, subject, small_settings(epochs=1, seed=1), released=folder, **same)
    assert found == folder
    with pytest.raises(AssertionError, match="trained again"):
        find_weights(dataset, subject, small_settings(epochs=1, seed=3), released=folder, **same)
    other = Subject("heuristic", "1", subject.train_m + 1e-6, subject.test_m)
    with pytest.raises(AssertionError, match="trained again"):
        find_weights(dataset, other, small_settings(epochs=1, seed=1), released=folder, **same)


def test_runs_survive_the_disk(runs: tuple[Run, ...], tmp_path: Path):
    write_runs(tmp_path / "judgements.jsonl", runs)
    assert read_runs(tmp_path / "judgements.jsonl") == runs


def test_the_table_has_every_figure_by_model_and_variant_ready_for_json(runs: tuple[Run, ...]):
    table = json.loads(json.dumps(mdes_table(runs)))
    assert set(table) == {"heuristic"}
    assert set(table["heuristic"]) == {"crop", "crop_upper", "paper", "paper_upper"}
    for figures in table["heuristic"].values():
        assert set(figures) >= KEYS
        assert figures["seeds"] == [0, 1]
        assert figures["samples"] == 8


def a_run(seed: int, means: list[float]) -> Run:
    truths = [0.1, 0.3, 0.6, 0.9]
    judgements = tuple(
        Judgement("learned", "crop", seed, index, index, truth, mean, min(mean + 0.2, 1.0), True)
        for index, (truth, mean) in enumerate(zip(truths, means, strict=True))
    )
    return Run(judgements, 0.4, 0.003, 0.9, 0.5, 1e-4, 1e-2, "")


def test_figures_are_means_over_seeds_with_their_spread():
    entry = mdes_table([a_run(0, [0.1, 0.3, 0.6, 0.9]), a_run(1, [0.3, 0.3, 0.2, 0.5])])["learned"]
    assert entry["crop"]["mae"] == pytest.approx((0 + 0.25) / 2)
    assert entry["crop"]["mae_std"] == pytest.approx(np.std([0.0, 0.25], ddof=1))
    assert entry["crop"]["median_baseline_mae"] == pytest.approx((0.4 + 0.2 + 0.1 + 0.4) / 4)
    assert entry["crop"]["false_accept_rate"] == pytest.approx((0 + 0.5) / 2)
    assert entry["crop"]["recall"] == 1.0
    assert entry["crop_upper"]["recall"] == pytest.approx((0.5 + 0.0) / 2)
    assert entry["crop"]["coverage"] == pytest.approx((1 + 0.5) / 2)


def test_figures_are_drawn_from_raw_results(dataset: Dataset, runs: tuple[Run, ...], work: Path, tmp_path: Path):
    estimator = read_estimator(work / "mde_heuristic-crop-0", model="heuristic")
    maps = accept_maps(
        dataset.state("test", 0),
        TASKS["plating"],
        Sinking(),
        {"heuristic": HeuristicModel()},
        {"heuristic": (estimator, deviation_scale(dataset), 0.4)},
        count=5,
    )
    write_map(tmp_path / "map.npz", maps[0])
    again = read_map(tmp_path / "map.npz")
    np.testing.assert_array_equal(again.truth, maps[0].truth)
    assert again.truth.shape == again.mean.shape == (5, 5)
    assert (again.model, again.d_max) == ("heuristic", 0.4)
    for name, figure in (("reliability", draw_reliability(runs)), ("maps", draw_accept_maps([again]))):
        png, _ = save_figure(figure, tmp_path / name)
        assert png.stat().st_size > 10_000
