"""The released weights, on placements that were never part of their data set: what a newcomer would measure first."""

import json
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest

from common.learning.weights import read_card
from services.cli.released import MODELS
from services.learned.model import LearnedModel
from services.mde.estimator import read_estimator

ROOT = Path(__file__).parents[2]


def frugal(*arguments: object) -> str:
    command = [sys.executable, "-m", "services.cli.main", *map(str, arguments)]
    done = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, timeout=110, check=False)
    assert done.returncode == 0, done.stderr
    return done.stdout


@pytest.fixture(scope="module")
def fresh(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Placements of a seed that no weights were trained on."""
    out = tmp_path_factory.mktemp("data")
    frugal("data", "generate", "--name", "fresh", "--out", out, "--seed", 77, "--train", 2, "--test", 80)
    return out / "fresh"


def test_they_are_what_their_cards_say():
    learned = LearnedModel.load(MODELS / "learned")
    assert learned.weights == read_card(MODELS / "learned").sha256
    scales = set()
    for model in ("heuristic", "learned"):
        card = read_card(MODELS / f"mde_{model}")
        assert read_estimator(MODELS / f"mde_{model}", model=model).weights == card.sha256
        assert (card.dataset.name, card.dataset.seed) == ("sim-v1", 0)
        scales.add(card.deviation_scale_m)
    assert len(scales) == 1  # one threshold means one length for every model


def test_the_learned_model_is_on_most_placements_less_than_half_as_wrong_as_the_heuristic(fresh: Path, tmp_path: Path):
    found = json.loads(frugal("evaluate", "models", "--data", fresh, "--fine", 0, "--out", tmp_path, "--json"))
    assert found["learned"]["samples"] == 80
    assert found["learned"]["rmse_median_m"] < 0.5 * found["heuristic"]["rmse_median_m"]
    assert found["learned"]["ratio"] < 0.6  # of 80 placements few decide: those in which fries roll


@pytest.mark.parametrize(("model", "largest_mae", "least_auroc"), [("heuristic", 0.07, 0.94), ("learned", 0.06, 0.85)])
def test_the_mdes_know_where_to_trust(fresh: Path, tmp_path: Path, model: str, largest_mae: float, least_auroc: float):
    command = ("evaluate", "mdes", "--released", "--data", fresh, "--model", model, "--out", tmp_path, "--json")
    figures: dict[str, Any] = json.loads(frugal(*command))[model]["crop"]
    assert figures["mae"] < largest_mae < figures["median_baseline_mae"]
    assert figures["auroc"] > least_auroc
    assert 0.8 <= figures["coverage"] <= 0.99
    assert figures["unfamiliar_share"] < 0.1
