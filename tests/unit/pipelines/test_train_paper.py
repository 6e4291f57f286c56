"""The paper's learned model: what it learns, keeps and refuses."""

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from common.domain.errors import ModelError, RequestError
from common.learning.training import seeded, train
from common.learning.weights import CARD, read_card
from common.storage.dataset import Dataset
from pipelines.predictions import predict_samples, rmse
from pipelines.train.images import Images
from pipelines.train.learned import PAPER, release
from services.learned.encoder_decoder import EncoderDecoder, EncoderDecoderSettings, PaperLearnedModel
from services.learned.load import load_learned
from tests.learned_fakes import save_learned
from tests.mde_fakes import write_dataset

SETTINGS = replace(
    PAPER,
    network=EncoderDecoderSettings((8, 16, 16, 16)),
    training=replace(PAPER.training, epochs=2, batch=4, learning_rate=5e-3, threads=1),
    validation_share=0.2,
)


@pytest.fixture(scope="module")
def dataset(tmp_path_factory: pytest.TempPathFactory) -> Dataset:
    return write_dataset(tmp_path_factory.mktemp("data") / "small")


@pytest.fixture(scope="module")
def released(dataset: Dataset, tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("models") / "learned"
    release(dataset, folder, SETTINGS)
    return folder


def test_its_card_names_the_architecture_and_it_is_found_by_it(released: Path, tmp_path: Path):
    save_learned(tmp_path)
    assert read_card(released).architecture == "paper"
    assert isinstance(load_learned(released), PaperLearnedModel)
    assert not isinstance(load_learned(tmp_path), PaperLearnedModel)


def test_it_learns_to_put_an_item_where_the_action_says(dataset: Dataset):
    samples = dataset.samples("train")
    images, everything = Images.of(samples, dataset.card.grid.grid()), np.arange(len(samples))
    with seeded(0):
        network = EncoderDecoder(EncoderDecoderSettings((16, 16, 16, 16)), images.grid)
    settings = replace(SETTINGS.training, epochs=60, patience=60)
    train(network, images.loss, training=everything, validation=everything, settings=settings)
    model = PaperLearnedModel(network, version="1")
    found = rmse(predict_samples(model, dataset, "train", samples, everything), samples.outcomes)
    assert found.mean() < 0.5 * rmse(samples.scene_heights, samples.outcomes).mean()


def test_an_answer_does_not_depend_on_its_batch(dataset: Dataset, released: Path):
    model, state = load_learned(released), dataset.state("train", 0)
    actions = np.array([[0.01, -0.02], [-0.03, 0.0], [0.02, 0.02]])
    alone = [model.predict(state, action[None]).heights[0] for action in actions]
    np.testing.assert_array_equal(model.predict(state, actions).heights, alone)


def test_a_card_with_other_sizes_is_refused(released: Path, tmp_path: Path):
    for path in released.iterdir():
        (tmp_path / path.name).write_bytes(path.read_bytes())
    card = json.loads((tmp_path / CARD).read_text())
    card["settings"]["network"] = {"widths": [8, 16, 15]}
    (tmp_path / CARD).write_text(json.dumps(card))
    with pytest.raises(ModelError, match="expected widths that are multiples of 8"):
        load_learned(tmp_path)


def test_a_grid_that_cannot_be_halved_four_times_is_refused(dataset: Dataset, tmp_path: Path):
    deep = replace(SETTINGS, network=EncoderDecoderSettings((8,) * 7))
    with pytest.raises(RequestError, match="expected a grid of multiples of 128 cells"):
        release(dataset, tmp_path, deep)
