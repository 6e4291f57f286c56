"""Deviations of a model that was trained on the same data: each sample by a copy that was not trained on it."""

from dataclasses import dataclass
from pathlib import Path
from zipfile import BadZipFile

import numpy as np
from numpy.typing import NDArray

from common.domain.errors import RequestError
from common.storage.dataset import Dataset
from common.storage.dataset_card import Split


class OtherSamplesError(RequestError):
    """Deviations are those of other samples than a data set's."""


@dataclass(frozen=True)
class CrossFitted:
    """Deviations of one model on a data set.

    Attributes:
        train_m: By cross-fitting, in the order of the training samples ``(N,)`` [m].
        test_m: Of the released model, in the order of the test samples ``(M,)`` [m].
        version: Version of the model.
    """

    train_m: NDArray[np.float64]
    test_m: NDArray[np.float64]
    version: str


def read_deviations(path: Path, dataset: Dataset) -> CrossFitted:
    """Read what the training of a model left for its MDE.

    The file holds ``deviation_m`` ``(N,)`` and ``test_deviation_m`` ``(M,)`` [m]. If it holds ``actions`` ``(N, 2)``
    and ``test_actions`` ``(M, 2)`` too, they tell which samples these are, and a data set may have fewer: its samples
    are then the first ones.

    Raises:
        OtherSamplesError: It says that it belongs to another data set.
        RequestError: There is no such file, or it is something else.
    """
    try:
        with np.load(path) as file:
            fields = {name: np.asarray(file[name]) for name in file.files}
        train = _of_split(path, fields, "", dataset, "train")
        test = _of_split(path, fields, "test_", dataset, "test")
    except (OSError, KeyError, ValueError, BadZipFile) as error:
        raise RequestError(f"{path}: expected deviation_m and test_deviation_m, got {error}") from None
    return CrossFitted(train, test, str(fields.get("version", "")))


def _of_split(
    path: Path, fields: dict[str, NDArray[np.generic]], prefix: str, dataset: Dataset, split: Split
) -> NDArray[np.float64]:
    """Return the deviations of one split's samples."""
    name, count = f"{prefix}deviation_m", dataset.card.counts[split]
    values = np.asarray(fields[name], dtype=np.float64)
    if (known := fields.get(f"{prefix}actions")) is not None:
        if not np.array_equal(known[:count], dataset.samples(split).actions):
            raise OtherSamplesError(f"{path}: {name}: expected those of the data set's samples, got those of others")
        values = values[:count]
    if values.shape != (count,) or not np.isfinite(values).all():
        raise RequestError(f"{path}: {name}: expected {count} finite numbers as in the data set, got {values.shape}")
    return values
