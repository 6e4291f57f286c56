"""What a method pays for: its own calls, each at what it took when it was computed, and nothing that is asked about it.

Several methods often simulate the same action of one target. It is computed once; a clock that is moved by what the
computation took makes every method pay as if it had been alone.
"""

import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from common.domain.deviation import DeviationEstimator, Estimates
from common.domain.errors import FrugalError
from common.domain.grid import Floats
from common.domain.model import PredictiveModel
from common.domain.scene import State
from common.planning.problem import Problem


@dataclass(frozen=True)
class Cost:
    """Time of one computation.

    Attributes:
        wall_s: By the wall's clock [s].
        processor_s: By the processor's, which other work on the machine does not lengthen [s].
    """

    wall_s: float = 0.0
    processor_s: float = 0.0

    def __sub__(self, other: "Cost") -> "Cost":
        return Cost(self.wall_s - other.wall_s, self.processor_s - other.processor_s)

    def __add__(self, other: "Cost") -> "Cost":
        return Cost(self.wall_s + other.wall_s, self.processor_s + other.processor_s)


def real_time() -> Cost:
    """Return what both clocks show."""
    return Cost(time.perf_counter(), time.process_time())


class Meter:
    """Two clocks that can be moved. Exact for one evaluation at a time.

    Attributes:
        is_paid: Whether the present method asked for what is computed now.
    """

    def __init__(self) -> None:
        self._moved = Cost()
        self.is_paid = True

    def now(self) -> Cost:
        """Return what the moved clocks show."""
        return real_time() + self._moved

    def clock(self) -> float:
        """Return what the moved wall clock shows [s]."""
        return self.now().wall_s

    def charge(self, cost: Cost) -> None:
        """Let the present method pay for something besides what is computed."""
        self._moved += cost

    @contextmanager
    def unpaid(self) -> Iterator[None]:
        """Stop the clocks."""
        began, was_paid = self.now(), self.is_paid
        self.is_paid = False
        try:
            yield
        finally:
            self.is_paid = was_paid
            self.charge(began - self.now())


class Metered(PredictiveModel):
    """A model whose every method pays for the preparation of a state; if it keeps outcomes, none is computed twice.

    Args:
        model: The model.
        meter: The clocks.
        keeps: Whether to keep the outcomes of the present target.
    """

    def __init__(self, model: PredictiveModel, meter: Meter, *, keeps: bool = False) -> None:
        self.name, self.version, self.largest_batch = model.name, model.version, model.largest_batch
        self._model = model
        self._meter = meter
        self._keeps = keeps
        self._kept: dict[tuple[str, bytes], tuple[Floats, str, Cost]] = {}
        self._has_paid = False
        self.preparation = Cost()
        self.call = Cost()

    def start_target(self, problem: Problem) -> None:
        """Forget the last target and measure what preparing this state takes: how much longer the first call is."""
        self._kept.clear()
        middle = problem.limits.mean(axis=1)[None]
        self.preparation, self.call = measure(lambda: self._model.predict(problem.state, middle))

    def start_run(self, preparation: Cost | None = None) -> None:
        """Let the next method pay for the preparation, or for another one."""
        self._has_paid = False
        self.preparation = self.preparation if preparation is None else preparation

    def outcomes(self, state: State, actions: NDArray[np.float64]) -> tuple[Floats, tuple[str, ...]]:
        """Return the model's heightmaps ``(B, H, W)`` [m] and warnings."""
        if self._meter.is_paid and not self._has_paid:
            self._has_paid = True
            self._meter.charge(self.preparation)
        if not self._keeps:
            found = self._model.predict(state, actions)
            return found.heights, found.warnings
        parts = [self._outcome(state, action) for action in actions]
        return np.stack([heights for heights, _ in parts]), tuple(warning for _, warning in parts)

    def _outcome(self, state: State, action: NDArray[np.float64]) -> tuple[Floats, str]:
        key, began = (state.digest, action.tobytes()), real_time()
        if key in self._kept:
            heights, warning, cost = self._kept[key]
            self._meter.charge(cost - (real_time() - began))
            return heights, warning
        found = self._model.predict(state, action[None])
        self._kept[key] = found.heights[0], found.warnings[0], real_time() - began
        return found.heights[0], found.warnings[0]


class MeteredEstimator(DeviationEstimator):
    """An MDE whose every method pays for what depends on the state alone.

    Args:
        estimator: The MDE.
        meter: The clocks.
    """

    def __init__(self, estimator: DeviationEstimator, meter: Meter) -> None:
        self.model, self.version, self.largest_batch = estimator.model, estimator.version, estimator.largest_batch
        self._estimator = estimator
        self._meter = meter
        self._has_paid = False
        self.preparation = Cost()

    def start_target(self, problem: Problem) -> None:
        """Measure what encoding this state takes."""
        middle = problem.limits.mean(axis=1)[None]
        self.preparation, _ = measure(lambda: self._estimator.estimate(problem.state, middle))

    def start_run(self) -> None:
        """Let the next method pay for it."""
        self._has_paid = False

    def deviations(self, state: State, actions: NDArray[np.float64]) -> Estimates:
        """Return the MDE's estimates ``(B,)``."""
        if not self._has_paid:
            self._has_paid = True
            self._meter.charge(self.preparation)
        return self._estimator.estimate(state, actions)


def measure(call: Callable[[], object]) -> tuple[Cost, Cost]:
    """Return how much longer the first of two calls takes than the second, and that; nothing where they fail."""
    began = real_time()
    try:
        call()
        first = real_time()
        call()
    except FrugalError:
        return Cost(), Cost()
    second = real_time() - first
    more = first - began - second
    return Cost(max(more.wall_s, 0.0), max(more.processor_s, 0.0)), second
