"""Deviations of a model that was trained on the same data: each sample by a copy that was not trained on it."""

from dataclasses import dataclass
from pathlib import Path
from zipfile import BadZipFile

import numpy as np
from numpy.typing import NDArray

from common.domain.errors import RequestError
from common.storage.dataset import Dataset


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

    Raises:
        RequestError: There is no such file, it is something else, or it belongs to another data set.
    """
    try:
        with np.load(path) as file:
            train, test = (np.asarray(file[name], dtype=np.float64) for name in ("deviation_m", "test_deviation_m"))
            version = str(file["version"]) if "version" in file else ""
    except (OSError, KeyError, ValueError, BadZipFile) as error:
        raise RequestError(f"{path}: expected deviation_m and test_deviation_m, got {error}") from None
    _check(path, "deviation_m", train, dataset.card.counts["train"])
    _check(path, "test_deviation_m", test, dataset.card.counts["test"])
    return CrossFitted(train, test, version)


def _check(path: Path, name: str, values: NDArray[np.float64], count: int) -> None:
    if values.shape != (count,) or not np.isfinite(values).all():
        raise RequestError(f"{path}: {name}: expected {count} finite numbers as in the data set, got {values.shape}")
