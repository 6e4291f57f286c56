"""Released weights: tensors in ``weights.safetensors`` and, beside them, what they are in ``card.json``."""

import hashlib
import os
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import safetensors
import safetensors.torch
from pydantic import BaseModel, ConfigDict, ValidationError
from torch import Tensor

from common.domain.errors import ModelError, RequestError
from common.domain.grid import Grid

TENSORS, CARD = "weights.safetensors", "card.json"


class GridCard(BaseModel):
    """A grid on a card."""

    model_config = ConfigDict(extra="forbid", frozen=True)

    rows: int
    columns: int
    cell: float

    @classmethod
    def of(cls, grid: Grid) -> "GridCard":
        """Return a grid's card."""
        return cls(rows=grid.rows, columns=grid.columns, cell=grid.cell)

    def grid(self) -> Grid:
        """Return the grid itself.

        Raises:
            ModelError: It is none.
        """
        try:
            return Grid(self.rows, self.columns, self.cell)
        except RequestError as error:
            raise ModelError(f"card: grid: {error}") from None


class DatasetCard(BaseModel):
    """The data that weights were trained on."""

    model_config = ConfigDict(extra="forbid", frozen=True)

    name: str
    seed: int
    version: str
    samples: int


class WeightsCard(BaseModel):
    """What a file of weights is.

    Attributes:
        name: Whose weights: ``learned``, ``mde_heuristic``, ...
        version: Version of model and weights together.
        architecture: Name of the network's variant.
        sha256: SHA-256 of the file of tensors in hex.
        dataset: The training data.
        grid: The only grid that the network takes.
        seed: Seed of the training.
        deviation_scale_m: Deviation that counts as 1 [m]; None where it does not apply.
        settings: Sizes of the network and settings of the training.
        metrics: Measured figures, by name.
        statistics: Whatever else the model needs to know of its training data, ready for JSON.
    """

    model_config = ConfigDict(extra="forbid", frozen=True)

    format: str = "frugal-weights-1"
    name: str
    version: str
    architecture: str
    sha256: str = ""
    dataset: DatasetCard
    grid: GridCard
    seed: int
    deviation_scale_m: float | None = None
    settings: dict[str, Any] = {}
    metrics: dict[str, Any] = {}
    statistics: dict[str, Any] = {}


def save(folder: Path, tensors: Mapping[str, Tensor], card: WeightsCard) -> WeightsCard:
    """Write tensors and card, the card last, and return the card with the tensors' SHA-256."""
    folder.mkdir(parents=True, exist_ok=True)
    content = _content(tensors)
    complete = card.model_copy(update={"sha256": hashlib.sha256(content).hexdigest()})
    _write(folder / TENSORS, content)
    _write(folder / CARD, (complete.model_dump_json(indent=2) + "\n").encode())
    return complete


def tensors_sha256(tensors: Mapping[str, Tensor]) -> str:
    """Return the SHA-256 in hex that a card will name for tensors."""
    return hashlib.sha256(_content(tensors)).hexdigest()


def read_card(folder: Path, *, name: str | None = None) -> WeightsCard:
    """Return the card of the weights in a folder.

    Raises:
        ModelError: There is none, it cannot be read, or it is of other weights than ``name``.
    """
    path = folder / CARD
    if not path.is_file():
        raise ModelError(f"weights: expected {path}, got no such file")
    return parse_card(path.read_bytes(), where=str(path), name=name)


def parse_card(content: bytes, *, where: str, name: str | None = None) -> WeightsCard:
    """Return a card from its JSON; ``where`` names it in errors.

    Raises:
        ModelError: It cannot be read, or is of other weights than ``name``.
    """
    try:
        card = WeightsCard.model_validate_json(content)
    except ValidationError as error:
        first = error.errors()[0]
        at = ".".join(str(part) for part in first["loc"])
        raise ModelError(f"{where}: {at + ': ' if at else ''}{first['msg']}, got {first['input']!r:.80}") from None
    expected = WeightsCard.model_fields["format"].default
    if card.format != expected:
        raise ModelError(f"{where}: expected format {expected}, got {card.format!r}")
    if name is not None and card.name != name:
        raise ModelError(f"{where}: expected weights of {name}, got {card.name!r}")
    return card


def load(
    folder: Path, expected: Mapping[str, Tensor], *, card: WeightsCard, grid: Grid | None = None
) -> dict[str, Tensor]:
    """Return the tensors in a folder after checking that they are what card and network say.

    Args:
        folder: Where `save` wrote.
        expected: A tensor of the right shape for every name, for instance a network's ``state_dict()``.
        card: What `read_card` returned for the folder.
        grid: The grid that the card must name, None: any.

    Raises:
        ModelError: Wrong SHA-256 or grid, missing or foreign tensors, wrong shapes, or no such file.
    """
    path = folder / TENSORS
    if not path.is_file():
        raise ModelError(f"weights: expected {path}, got no such file")
    return parse_tensors(path.read_bytes(), expected, card=card, grid=grid, where=str(folder))


def parse_tensors(
    content: bytes, expected: Mapping[str, Tensor], *, card: WeightsCard, grid: Grid | None = None, where: str
) -> dict[str, Tensor]:
    """Return the tensors in a safetensors file's bytes, checked as `load` does; ``where`` names them in errors."""
    path = f"{where}/{TENSORS}"
    found = hashlib.sha256(content).hexdigest()
    if found != card.sha256:
        raise ModelError(f"{path}: expected SHA-256 {card.sha256 or 'none'} as its card says, got {found}")
    if grid is not None and card.grid.grid() != grid:
        raise ModelError(f"{where}/{CARD}: expected {grid}, got {card.grid.grid()}")
    try:
        tensors = safetensors.torch.load(content)
    except safetensors.SafetensorError as error:
        raise ModelError(f"{path}: expected a safetensors file, got {error}") from None
    missing, foreign = sorted(expected.keys() - tensors.keys()), sorted(tensors.keys() - expected.keys())
    if missing or foreign:
        raise ModelError(f"{path}: expected the network's tensors, got none of {missing} and the foreign {foreign}")
    for name, tensor in tensors.items():
        if tensor.shape != expected[name].shape or tensor.dtype != expected[name].dtype:
            raise ModelError(
                f"{path}: {name}: expected {expected[name].dtype} {tuple(expected[name].shape)}, "
                f"got {tensor.dtype} {tuple(tensor.shape)}"
            )
        if not tensor.isfinite().all():
            raise ModelError(f"{path}: {name}: expected finite numbers, got NaN or infinite ones")
    return tensors


def _content(tensors: Mapping[str, Tensor]) -> bytes:
    return safetensors.torch.save({name: tensor.detach().contiguous() for name, tensor in tensors.items()})


def _write(path: Path, content: bytes) -> None:
    unfinished = path.with_name(f".{path.name}.{os.getpid()}")
    unfinished.write_bytes(content)
    unfinished.replace(path)
