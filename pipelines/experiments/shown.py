"""What a view makes."""

from dataclasses import dataclass
from typing import TYPE_CHECKING

from pipelines.experiments.numbers import Number

if TYPE_CHECKING:
    from matplotlib.figure import Figure


@dataclass(frozen=True)
class Shown:
    """An experiment as a reader sees it.

    Attributes:
        numbers: Its numbers in the order of the table.
        figure: Its figure; None for a table.
    """

    numbers: tuple[Number, ...]
    figure: "Figure | None" = None
