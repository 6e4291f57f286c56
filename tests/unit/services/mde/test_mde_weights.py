"""Weights of MDEs on disk: what they say comes back, and lies are refused."""

import json
import shutil
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from common.domain.errors import ModelError
from common.storage.dataset import Dataset
from pipelines.mde.train import CALIBRATION, parts
from services.mde.ensemble import load_ensemble
from services.mde.estimator import read_estimator
from tests.mde_fakes import small_settings, write_dataset, write_weights


@pytest.fixture(scope="module")
def dataset(tmp_path_factory: pytest.TempPathFactory) -> Dataset:
    return write_dataset(tmp_path_factory.mktemp("data") / "small")


@pytest.fixture(scope="module")
def released(dataset: Dataset, tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("weights") / "mde_heuristic"
    write_weights(folder, dataset)
    return folder


@pytest.fixture
def copy(released: Path, tmp_path: Path) -> Path:
    return shutil.copytree(released, tmp_path / "copy")


def test_the_same_seed_gives_the_same_weights_and_another_one_others(dataset: Dataset, released: Path, tmp_path: Path):
    again = write_weights(tmp_path / "again", dataset)
    other = write_weights(tmp_path / "other", dataset, small_settings(seed=1))
    assert (tmp_path / "again" / "weights.safetensors").read_bytes() == (released / "weights.safetensors").read_bytes()
    assert again.sha256 == load_ensemble(released, model="heuristic").card.sha256 != other.sha256


def test_the_card_tells_what_the_weights_rest_on(dataset: Dataset, released: Path):
    card = load_ensemble(released, model="heuristic").card
    assert (card.name, card.architecture, card.seed) == ("mde_heuristic", "crop", 0)
    assert (card.dataset.name, card.dataset.seed, card.dataset.samples) == ("small", 5, 32)
    assert card.grid.grid() == dataset.card.grid.grid()
    assert card.deviation_scale_m is not None
    assert 0 < card.deviation_scale_m < 0.01
    assert 0.05 <= card.metrics["d_max"] <= 1
    assert card.settings["members"] == 2


@pytest.mark.parametrize("members", [1, 2])
def test_the_calibration_rests_on_states_that_no_member_was_trained_on(dataset: Dataset, members: int):
    settings, groups = small_settings(members=members), dataset.samples("train").groups
    part = parts(groups, settings)
    kept, trained = groups[part == CALIBRATION], groups[part != CALIBRATION]
    assert len(set(kept)) == round(settings.calibration_share * len(set(groups)))
    assert not set(kept) & set(trained)
    for member in range(members):
        assert not set(groups[part == member]) & set(groups[(part != member) & (part != CALIBRATION)])


def test_the_card_tells_how_good_the_members_are_together_on_these_states(dataset: Dataset, released: Path):
    held_out = load_ensemble(released, model="heuristic").card.metrics["held_out"]
    assert held_out["samples"] == (parts(dataset.samples("train").groups, small_settings()) == CALIBRATION).sum()
    assert 0 < held_out["mae"] < 1


def test_the_paper_s_variant_is_a_single_network_with_a_constant_margin(dataset: Dataset, tmp_path: Path):
    write_weights(tmp_path / "paper", dataset, small_settings("paper", members=1, epochs=20))
    estimator = read_estimator(tmp_path / "paper", model="heuristic")
    estimates = estimator.estimate(dataset.state("test", 0), np.linspace(-0.05, 0.05, 12).reshape(6, 2))
    inside = (estimates.mean > 0) & (estimates.upper < 1)
    assert inside.sum() > 1
    assert np.ptp((estimates.upper - estimates.mean)[inside]) < 1e-6


def change(**fields: Any) -> Callable[[Path], None]:
    def spoil(folder: Path) -> None:
        path = folder / "card.json"
        path.write_text(json.dumps(json.loads(path.read_text()) | fields))

    return spoil


def change_settings(**fields: Any) -> Callable[[Path], None]:
    def spoil(folder: Path) -> None:
        settings = json.loads((folder / "card.json").read_text())["settings"]
        change(settings=settings | fields)(folder)

    return spoil


def flip_a_byte(folder: Path) -> None:
    path = folder / "weights.safetensors"
    content = bytearray(path.read_bytes())
    content[-7] ^= 1
    path.write_bytes(bytes(content))


def forget(name: str) -> Callable[[Path], None]:
    return lambda folder: (folder / name).unlink()


LIES: dict[str, tuple[Callable[[Path], None], str]] = {
    "another sha256": (change(sha256="0" * 64), "expected SHA-256 0000"),
    "a changed byte": (flip_a_byte, "expected SHA-256"),
    "another grid": (change(grid={"rows": 96, "columns": 96, "cell": 0.003}), "grid: expected 64 x 64 cells of 0.0045"),
    "another cell": (change(grid={"rows": 64, "columns": 64, "cell": 0.003}), "grid: expected 64 x 64 cells of 0.0045"),
    "another scale": (change(deviation_scale_m=0.5), "deviation_scale_m: expected"),
    "no scale": (change(deviation_scale_m=None), "deviation_scale_m: expected"),
    "another model": (change(name="mde_learned"), "expected weights of mde_heuristic, got 'mde_learned'"),
    "another architecture": (change(architecture="paper"), "expected those of paper"),
    "an unknown architecture": (change(architecture="oracle"), "expected an architecture of crop, paper"),
    "more members": (change_settings(members=3), "expected the network's tensors"),
    "other sizes": (change_settings(network={"channels": [8, 8, 12, 32], "features": 8}), "expected torch.float32"),
    "a network that no memory holds": (
        change_settings(network={"channels": [8, 8, 12, 2 * 10**9], "features": 8}),
        "expected torch.float32",
    ),
    "a million members": (change_settings(members=10**6), "settings: expected those of crop"),
    "no statistics": (change(statistics={}), "statistics: expected what the data covers"),
    "no card": (forget("card.json"), "got no such file"),
    "no weights": (forget("weights.safetensors"), "got no such file"),
    "no JSON": (lambda folder: (folder / "card.json").write_text("{"), "card.json"),
}


@pytest.mark.parametrize("lie", LIES)
def test_weights_that_are_not_what_their_card_says_are_refused(copy: Path, lie: str):
    spoil, complaint = LIES[lie]
    spoil(copy)
    with pytest.raises(ModelError, match=complaint):
        load_ensemble(copy, model="heuristic")
