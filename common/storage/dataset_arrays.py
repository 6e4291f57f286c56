"""The arrays of one split of a data set: one state, with its samples, is one chunk of each."""

from pathlib import Path
from typing import Any

import numpy as np
import zarr
import zarr.codecs
import zarr.errors
from numpy.typing import NDArray

from common.domain.errors import RequestError
from common.domain.grid import Grid

STATE_ARRAYS = ("scene_heights", "scene_materials", "item_heights", "item_materials")
SAMPLE_ARRAYS = ("actions", "outcomes")


class SplitArrays:
    """Zarr arrays ``(S, ...)`` of the states and ``(S K, ...)`` of their samples; NaN where nothing was written.

    Args:
        folder: Where the split is.
        arrays: By name, see `STATE_ARRAYS` and `SAMPLE_ARRAYS`.
        actions_per_state: K.
    """

    def __init__(self, folder: Path, arrays: dict[str, zarr.Array[Any]], actions_per_state: int) -> None:
        self.folder = folder
        self._arrays = arrays
        self._samples = actions_per_state

    @classmethod
    def create(cls, folder: Path, *, grid: Grid, actions_per_state: int) -> "SplitArrays":
        """Create the arrays with no states, or open those that are there already."""
        cells, each = grid.shape, {"scene_heights": (), "item_heights": ()}
        each |= {"scene_materials": (3,), "item_materials": (3,)}
        layout: dict[str, tuple[int, tuple[int, ...], str]] = {
            name: (1, (*each[name], *cells), "float32") for name in STATE_ARRAYS
        }
        layout |= {"actions": (actions_per_state, (2,), "float64"), "outcomes": (actions_per_state, cells, "float32")}
        arrays: dict[str, zarr.Array[Any]] = {}
        for name, (together, shape, dtype) in layout.items():
            if not (folder / name / "zarr.json").exists():
                zarr.create_array(
                    folder / name,
                    shape=(0, *shape),
                    chunks=(together, *shape),
                    dtype=dtype,
                    compressors=zarr.codecs.ZstdCodec(level=3, checksum=True),
                    fill_value=np.nan,
                )
            arrays[name] = _open(folder / name, "r+")
        return cls(folder, arrays, actions_per_state)

    @classmethod
    def open(cls, folder: Path, *, grid: Grid, actions_per_state: int, states: int) -> "SplitArrays":
        """Open the arrays for reading.

        Raises:
            RequestError: An array is not there or has another shape.
        """
        arrays = {name: _open(folder / name, "r") for name in (*STATE_ARRAYS, *SAMPLE_ARRAYS)}
        for name, array in arrays.items():
            count = states * (actions_per_state if name in SAMPLE_ARRAYS else 1)
            middle = {"scene_materials": (3,), "item_materials": (3,)}.get(name, ())
            expected = (count, 2) if name == "actions" else (count, *middle, *grid.shape)
            if array.shape != expected:
                raise RequestError(f"{folder / name}: expected an array of shape {expected}, got {array.shape}")
        return cls(folder, arrays, actions_per_state)

    def resize(self, states: int) -> None:
        """Make room for, or keep, this many states."""
        for name, array in self._arrays.items():
            count = states * (self._samples if name in SAMPLE_ARRAYS else 1)
            if array.shape[0] != count:
                array.resize((count, *array.shape[1:]))

    @property
    def states(self) -> int:
        """States that there is room for."""
        return min(
            array.shape[0] // (self._samples if name in SAMPLE_ARRAYS else 1) for name, array in self._arrays.items()
        )

    def write(self, name: str, state: int, values: NDArray[Any]) -> None:
        """Write one state's chunk of an array; it appears whole or not at all."""
        self._arrays[name][self._range(name, state, state + 1)] = values if name in SAMPLE_ARRAYS else values[None]

    def read(self, name: str, first: int = 0, last: int | None = None) -> NDArray[Any]:
        """Read the states from ``first`` to before ``last``, all by default.

        Raises:
            RequestError: A chunk is damaged.
        """
        array = self._arrays[name]
        last = self.states if last is None else last
        try:
            return np.asarray(array[self._range(name, first, last)])
        except (RuntimeError, ValueError, OSError) as error:
            raise RequestError(f"{self.folder / name}: expected intact chunks, got a damaged one: {error}") from None

    def _range(self, name: str, first: int, last: int) -> slice:
        together = self._samples if name in SAMPLE_ARRAYS else 1
        return slice(first * together, last * together)


def _open(folder: Path, mode: Any) -> "zarr.Array[Any]":
    try:
        return zarr.open_array(folder, mode=mode, zarr_format=3)
    except (FileNotFoundError, zarr.errors.NodeTypeValidationError):
        raise RequestError(f"expected a Zarr array at {folder}, got none") from None
    except (ValueError, KeyError, TypeError) as error:
        raise RequestError(f"{folder}: expected a Zarr array, got something else: {error}") from None
