"""Ask and tell: which action to evaluate next, given what the earlier ones were worth."""

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from common.domain.errors import RequestError
from common.planning.gp import Float64s, GaussianProcess
from common.planning.problem import check_bounds
from common.planning.space import embed
from common.planning.ucb import is_free, maximise, neighbourhoods, quasi_random, spread

BETA = 4.0
INITIAL = 6
"""Actions asked before the model has a say; more cost steps, fewer miss the better of two peaks."""
SCALES = (0.06, 0.1, 0.18, 0.3, 0.5)
"""Length scales in 2-D as shares of the range; the most probable one is used."""
SCALE_MEDIAN, SCALE_DEVIATION = 0.18, 0.5
"""Log-normal prior of the length scale."""
NOISE = 1e-4
"""Variance of the noise as a share of the rewards' variance."""
RADII = (1 / 64, 1 / 256, 1 / 1024)
"""Neighbourhoods that are searched around the best candidates up to 2-D, as shares of the range."""
LARGEST = 256
"""Rewards that the process holds at most; beyond, half of them are left out."""

Belief = Callable[[Float64s | None], tuple[Float64s, Float64s]]
"""Mean and standard deviation of the reward ``(M,)`` at points of the unit cube ``(M, n)``, the candidates if None."""


@dataclass(frozen=True)
class Incumbent:
    """The best action so far.

    Attributes:
        index: Order of asking, from 0.
        action: The action's parameters ``(n,)``.
        reward: Its reward.
    """

    index: int
    action: NDArray[np.float64]
    reward: float


class Planner:
    """GP-UCB with pending points (GP-BUCB), the same for the same seed and the same calls.

    Several actions may be asked before the first of them is told. A pending action lowers the uncertainty around
    it as if its reward were known already, without moving the mean; so does, for good, an action that failed.

    Args:
        bounds: Smallest and largest value of each action parameter ``(n, 2)``, n from 1 to 6.
        seed: Moves the initial actions.
        beta: Weight of the uncertainty: the bound is ``mean + sqrt(beta) std``.
        initial: Number of actions asked before the model has a say.
        circular: Which parameters are circles that the bounds close ``(n,)``; None: none.

    Raises:
        RequestError: The bounds are empty, not finite or of the wrong shape.
    """

    def __init__(
        self,
        bounds: NDArray[np.float64],
        *,
        seed: int,
        beta: float = BETA,
        initial: int = INITIAL,
        circular: NDArray[np.bool_] | None = None,
    ) -> None:
        limits = check_bounds(bounds)
        self._lower, self._range = limits[:, 0], limits[:, 1] - limits[:, 0]
        dimensions = len(limits)
        self._beta = beta
        self._initial = initial
        self._shift = np.random.default_rng(seed).random(dimensions)
        self._candidates = spread(dimensions)
        self._circular = np.zeros(dimensions, dtype=bool) if circular is None else circular
        self._radii = RADII if dimensions <= 2 else neighbourhoods(dimensions, RADII[-1])
        embedded = embed(self._candidates, self._circular)
        # Distances in the unit cube grow with the square root of its dimension, and so must length scales.
        scales = np.array(SCALES) * math.sqrt(dimensions / 2)
        self._log_prior = -((np.log(np.array(SCALES) / SCALE_MEDIAN) / SCALE_DEVIATION) ** 2) / 2
        self._process = GaussianProcess(
            np.repeat(scales[:, None], embedded.shape[1], axis=1), noise=NOISE, candidates=embedded
        )
        self._modelled: list[int] = []
        self._left_out: set[int] = set()
        self._free = np.ones(len(self._candidates), dtype=bool)
        self._points: list[Float64s] = []
        self._rewards: dict[int, float] = {}
        self._failed: set[int] = set()

    def ask(self) -> tuple[int, NDArray[np.float64]]:
        """Return the index of a new trial and its action ``(n,)``."""
        index = len(self._points)
        if index < self._initial or not self._rewards:
            point = (quasi_random(index + 1, len(self._lower))[-1] + self._shift) % 1
        else:
            point = self._highest_bound()
        self._points.append(point)
        self._free &= is_free(self._candidates, point[None])
        return index, self._lower + point * self._range

    def tell(self, index: int, reward: float | None) -> None:
        """Learn what trial ``index`` was worth, None if it failed.

        Raises:
            RequestError: The trial was never asked or is told already, or the reward is not finite.
        """
        if not 0 <= index < len(self._points) or index in self._rewards or index in self._failed:
            raise RequestError(f"tell: expected a pending trial, got {index}")
        if reward is not None and not math.isfinite(reward):
            raise RequestError(f"tell: expected a finite reward, got {reward}")
        if reward is None:
            self._failed.add(index)
        else:
            self._rewards[index] = reward

    @property
    def incumbent(self) -> Incumbent | None:
        """The best action told so far, the earliest of equals; None before the first."""
        if not self._rewards:
            return None
        index = max(self._rewards, key=lambda i: (self._rewards[i], -i))
        return Incumbent(index, self._lower + self._points[index] * self._range, self._rewards[index])

    def _belief(self) -> Belief:
        """Return what the rewards so far say about all others."""
        fit = self._process.fit(self._update())
        scale = int((fit.log_likelihood + self._log_prior).argmax())

        def belief(points: Float64s | None) -> tuple[Float64s, Float64s]:
            seen = None if points is None else embed(points, self._circular)
            return self._process.predict(fit, seen, scale=scale)

        return belief

    def _highest_bound(self) -> Float64s:
        """Return the point ``(n,)`` to ask next."""
        belief, weight = self._belief(), math.sqrt(self._beta)

        def bound(points: Float64s) -> Float64s:
            mean, deviation = belief(points)
            return mean + weight * deviation

        mean, deviation = belief(None)
        bounds = np.where(self._free, mean + weight * deviation, -np.inf)
        best, likely = int(bounds.argmax()), int(mean.argmax())
        incumbent = max(self._rewards, key=self._rewards.__getitem__)
        return maximise(
            bound,
            np.stack([self._candidates[best], self._candidates[likely], self._points[incumbent]]),
            np.array([bounds[best], bounds[likely], -np.inf]),
            radii=self._radii,
            taken=np.stack(self._points),
            circular=self._circular if self._circular.any() else None,
        )

    def _update(self) -> Float64s:
        """Make the process hold the told points first, then the others; return the rewards of the told ones."""
        told = [i for i in self._rewards if i not in self._left_out]
        if len(told) > LARGEST:
            best = set(sorted(told, key=self._rewards.__getitem__)[-LARGEST // 4 :])
            self._left_out.update([i for i in told if i not in best][::2])
            told = [i for i in told if i not in self._left_out]
        order = told + [i for i in range(len(self._points)) if i not in self._rewards]
        same = 0
        while same < min(len(order), len(self._modelled)) and order[same] == self._modelled[same]:
            same += 1
        self._process.truncate(same)
        for index in order[same:]:
            self._process.append(embed(self._points[index], self._circular))
        self._modelled = order
        return np.array([self._rewards[i] for i in told])
