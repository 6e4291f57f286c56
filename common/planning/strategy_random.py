"""Control: a model by chance for every query."""

from collections.abc import Iterator

import numpy as np

from common.planning.strategy import Query, Strategy


class RandomStrategy(Strategy):
    """Ask any model that has an MDE, or the trusted one, all with the same probability; then the trusted one."""

    name = "random"

    def required(self, trusted: str) -> str:
        """Return the trusted model."""
        return trusted

    def order(self, query: Query) -> Iterator[str]:
        """Yield the drawn model, then the trusted one."""
        choices = [model for model in query.models if model == query.trusted or model in query.estimable]
        # Seeded by the index, so that the draw does not depend on which thread comes first.
        drawn = choices[int(np.random.default_rng([query.seed, query.index]).integers(len(choices)))]
        yield drawn
        if drawn != query.trusted:
            yield query.trusted
