"""Weights that are not what their card says are refused."""

import json
from pathlib import Path

import pytest
import torch

from common.domain.errors import ModelError
from common.domain.grid import Grid
from common.learning.weights import CARD, TENSORS, DatasetCard, GridCard, WeightsCard, load, read_card, save

GRID = Grid(16, 16, 0.003)
TENSOR = {"layer.weight": torch.arange(6, dtype=torch.float32).reshape(2, 3), "layer.bias": torch.ones(2)}


@pytest.fixture
def card(tmp_path: Path) -> WeightsCard:
    drawn = WeightsCard(
        name="learned",
        version="1",
        architecture="small",
        dataset=DatasetCard(name="toy", seed=0, version="1", samples=10),
        grid=GridCard.of(GRID),
        seed=0,
    )
    return save(tmp_path, TENSOR, drawn)


def test_what_was_saved_is_loaded(tmp_path: Path, card: WeightsCard):
    found = load(tmp_path, TENSOR, card=read_card(tmp_path, name="learned"), grid=GRID)
    assert found.keys() == TENSOR.keys()
    assert all(torch.equal(found[name], tensor) for name, tensor in TENSOR.items())
    assert card == read_card(tmp_path)


def test_a_flipped_bit_is_found(tmp_path: Path, card: WeightsCard):
    content = bytearray((tmp_path / TENSORS).read_bytes())
    content[-1] ^= 1
    (tmp_path / TENSORS).write_bytes(content)
    with pytest.raises(ModelError, match=rf"expected SHA-256 {card.sha256} as its card says, got [0-9a-f]{{64}}"):
        load(tmp_path, TENSOR, card=card)


def test_another_grid_is_refused(tmp_path: Path, card: WeightsCard):
    with pytest.raises(ModelError, match=r"expected Grid\(rows=16, columns=17.*got Grid\(rows=16, columns=16"):
        load(tmp_path, TENSOR, card=card, grid=Grid(16, 17, 0.003))


@pytest.mark.parametrize(
    ("expected", "message"),
    [
        ({**TENSOR, "head.bias": torch.ones(1)}, r"none of \['head.bias'\] and the foreign \[\]"),
        ({"layer.bias": torch.ones(2)}, r"none of \[\] and the foreign \['layer.weight'\]"),
        (
            {**TENSOR, "layer.bias": torch.ones(3)},
            r"layer.bias: expected torch.float32 \(3,\), got torch.float32 \(2,\)",
        ),
        ({**TENSOR, "layer.bias": torch.ones(2).double()}, "layer.bias: expected torch.float64"),
    ],
)
def test_tensors_of_another_network_are_refused(tmp_path: Path, card: WeightsCard, expected: dict, message: str):
    with pytest.raises(ModelError, match=message):
        load(tmp_path, expected, card=card)


def test_tensors_that_are_not_finite_are_refused(tmp_path: Path, card: WeightsCard):
    saved = save(tmp_path, {**TENSOR, "layer.bias": torch.tensor([1.0, torch.nan])}, card)
    with pytest.raises(ModelError, match=r"layer.bias: expected finite"):
        load(tmp_path, TENSOR, card=saved)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"name": "mde_heuristic"}, "expected weights of learned, got 'mde_heuristic'"),
        ({"format": "frugal-weights-0"}, "expected format frugal-weights-1, got 'frugal-weights-0'"),
        ({"seed": "x"}, "seed: Input should be a valid integer.*got 'x'"),
        ({"colour": "red"}, "colour: Extra inputs are not permitted"),
    ],
)
def test_cards_of_something_else_are_refused(tmp_path: Path, card: WeightsCard, change: dict, message: str):
    (tmp_path / CARD).write_text(json.dumps({**card.model_dump(), **change}))
    with pytest.raises(ModelError, match=message):
        read_card(tmp_path, name="learned")


def test_missing_and_unreadable_files_are_named(tmp_path: Path, card: WeightsCard):
    with pytest.raises(ModelError, match=r"expected .*card.json, got no such file"):
        read_card(tmp_path / "nowhere")
    (tmp_path / CARD).write_text("{")
    with pytest.raises(ModelError, match=r"card.json: Invalid JSON"):
        read_card(tmp_path)
    (tmp_path / TENSORS).unlink()
    with pytest.raises(ModelError, match=r"expected .*weights.safetensors, got no such file"):
        load(tmp_path, TENSOR, card=card)


def test_a_file_that_is_no_safetensors_is_refused_even_with_the_right_digest(tmp_path: Path, card: WeightsCard):
    import hashlib

    (tmp_path / TENSORS).write_bytes(b"not tensors")
    honest = card.model_copy(update={"sha256": hashlib.sha256(b"not tensors").hexdigest()})
    with pytest.raises(ModelError, match="expected a safetensors file"):
        load(tmp_path, TENSOR, card=honest)
