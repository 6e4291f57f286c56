"""Operations on heightmaps."""

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
