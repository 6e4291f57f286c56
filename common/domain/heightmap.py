"""Operations on heightmaps."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from common.domain.grid import Floats


def shift(image: Floats, columns: float, rows: float) -> NDArray[np.float32]:
    """Shift an image by a number of cells, bilinear between cells, exact at whole ones, 0 flowing in.

    Args:
        image: ``(..., H, W)``.
        columns: Cells to the right (+x).
        rows: Cells towards larger row numbers (+y).

    Returns:
        The shifted image, same shape.
    """
    whole_columns, whole_rows = int(np.floor(columns)), int(np.floor(rows))
    part_columns, part_rows = columns - whole_columns, rows - whole_rows
    shifted = np.zeros(image.shape, dtype=np.float32)
    for row_step, row_weight in ((0, 1 - part_rows), (1, part_rows)):
        for column_step, column_weight in ((0, 1 - part_columns), (1, part_columns)):
            weight = row_weight * column_weight
            if weight > 0:
                _add_moved(shifted, image, whole_columns + column_step, whole_rows + row_step, weight)
    return shifted


def _add_moved(target: NDArray[np.float32], image: Floats, columns: int, rows: int, weight: float) -> None:
    height, width = image.shape[-2:]
    if abs(columns) >= width or abs(rows) >= height:
        return
    to_rows = slice(max(rows, 0), height + min(rows, 0))
    to_columns = slice(max(columns, 0), width + min(columns, 0))
    from_rows = slice(max(-rows, 0), height + min(-rows, 0))
    from_columns = slice(max(-columns, 0), width + min(-columns, 0))
    target[..., to_rows, to_columns] += np.float32(weight) * image[..., from_rows, from_columns]


@dataclass(frozen=True)
class Taps:
    """The four cells between which each cell of a turned image lies before the turn, and their bilinear weights.

    Attributes:
        window: Rows and columns of the turned image.
        rows, columns: The cells before ``(4, h, w)``, clipped to the image.
        weights: Their weights, 0 outside of the image ``(4, h, w)``.
    """

    window: tuple[slice, slice]
    rows: NDArray[np.intp]
    columns: NDArray[np.intp]
    weights: NDArray[np.float32]


def turn_taps(
    shape: tuple[int, int], angle: float, *, centre: tuple[float, float], window: tuple[slice, slice]
) -> Taps:
    """Return where the cells of a window come from when an image is turned counter-clockwise, from x to y.

    Args:
        shape: Of the image ``(H, W)``.
        angle: Of the turn [rad].
        centre: What stays where it is, row and column [cells].
        window: Rows and columns of the turned image that are wanted.
    """
    down = np.arange(window[0].start, window[0].stop, dtype=np.float64)[:, None] - centre[0]
    along = np.arange(window[1].start, window[1].stop, dtype=np.float64)[None, :] - centre[1]
    cos, sin = np.cos(angle), np.sin(angle)
    # Rounded so that quarter turns meet whole cells.
    place_row = (centre[0] + cos * down - sin * along).round(9)
    place_column = (centre[1] + cos * along + sin * down).round(9)
    row, column = np.floor(place_row).astype(np.intp), np.floor(place_column).astype(np.intp)
    part_row, part_column = (place_row - row).astype(np.float32), (place_column - column).astype(np.float32)
    rows, columns = np.stack([row, row, row + 1, row + 1]), np.stack([column, column + 1, column, column + 1])
    left, below = 1 - part_column, 1 - part_row
    weights = np.stack([below * left, below * part_column, part_row * left, part_row * part_column])
    inside = (rows >= 0) & (rows < shape[0]) & (columns >= 0) & (columns < shape[1])
    return Taps(
        window, rows.clip(0, shape[0] - 1), columns.clip(0, shape[1] - 1), np.where(inside, weights, np.float32(0))
    )
