"""Weights of the learned model, of whichever architecture their card names."""

from pathlib import Path

from common.learning.weights import read_card
from services.learned.encoder_decoder import ARCHITECTURE as PAPER
from services.learned.encoder_decoder import PaperLearnedModel
from services.learned.model import LearnedModel


def load_learned(folder: Path) -> LearnedModel | PaperLearnedModel:
    """Return the learned model with the weights in a folder.

    Raises:
        ModelError: There are none, or they are not what their card says.
    """
    if read_card(folder, name=LearnedModel.name).architecture == PAPER:
        return PaperLearnedModel.load(folder)
    return LearnedModel.load(folder)
