"""Control: one model for every query."""

from collections.abc import Iterator

from common.planning.strategy import Query, Strategy


class OnlyStrategy(Strategy):
    """Ask the named model alone, whatever its MDE says; another one would spoil the comparison.

    Args:
        model: Name of the model.
    """

    def __init__(self, model: str) -> None:
        self.name = f"only:{model}"
        self._model = model

    def required(self, trusted: str) -> str:
        """Return the named model."""
        return self._model

    def order(self, query: Query) -> Iterator[str]:
        """Yield the named model."""
        yield self._model
