"""What several simulations say together about the actions near them: their transported outcomes, blended.

The settled surface in the item's own frame is taken for a Gaussian process of the action, one for every point of it,
with a common covariance; `blend` then is ordinary kriging: ``P(a) = sum_k w_k(a) P_k(a)`` with the transported
outcomes ``P_k`` and weights that sum to 1. Blending outcomes instead of their rewards lets two outcomes on either side
of the target meet it in between, and a trend go on beyond both (composite Bayesian optimisation, Astudillo and
Frazier, 2019).
"""

from math import sqrt
from typing import Any, cast

import numpy as np
from numpy.typing import NDArray

from common.domain.grid import Floats
from common.domain.transport import Transport
from common.planning.gp import Float64s

LENGTHS = np.array([2, 4, 8, 16, 32, 64]) * 1e-3
"""Length scales of the surface [m]; the likelihood and `PRIOR` choose one of them, and one of the noises."""
NOISES = np.array([1e-3, 1e-2, 5e-2, 2e-1])
"""Variances of what differs between neighbours, as shares of the surface's variance."""
PRIOR = 16e-3, 4.0, 1e-2, 10.0
"""Length scale [m] and noise that are most likely beforehand, each with the factor that is a standard deviation."""
INDEPENDENT = 30.0
"""Points of the surface that tell as much as all of them, which are alike where they are near each other."""
SURFACE = 1e-3
"""Standard deviation of the surface before it was seen twice [m]; it counts as half a simulation."""
SAME = 1e-6
"""Distance below which two actions are one [m]."""
KEPT = 32
"""Simulations that are remembered."""
MOST = 4
"""Simulations that are blended, those with the largest weights."""
NOISE, FAR, SHARE = 1e-5, 0.02, 0.2
"""Error of a reward: at no distance [m], per distance to the nearest simulation, and as a share of the surface's."""
TRUST = 2.0
"""Predicted rewards that were as far off as was said, before any was compared."""
WORST = 6.0
"""No prediction counts as further off than so many times what was said."""


class Blend:
    """Predicts the rewards of actions near simulated ones, and how far off it is, by how far off it was.

    Args:
        target: The goal heightmap ``(H, W)`` [m].
    """

    def __init__(self, target: Floats) -> None:
        self._target = np.asarray(target, dtype=np.float32)
        self._transports: list[Transport] = []
        self._actions: list[Float64s] = []
        self._surfaces: list[NDArray[np.float32]] = []
        self._squares: list[float] = []

    def __len__(self) -> int:
        return len(self._transports)

    def add(self, action: Float64s, transport: Transport) -> None:
        """Learn the outcome of an action ``(n,)``, in place of one known there, or of the furthest of `KEPT`."""
        if len(self):
            distances = self._distances(action[None])[0]
            if distances.min() < SAME:
                self._forget(int(distances.argmin()))
            elif len(self) == KEPT:
                self._forget(int(distances.argmax()))
        self._transports.append(transport)
        self._actions.append(action)
        self._surfaces.append(transport.aligned())
        self._fit()

    def _forget(self, index: int) -> None:
        for known in (self._transports, self._actions, self._surfaces):
            del known[index]

    def compare(self, action: Float64s, reward: float) -> None:
        """Learn how far off the prediction for an action ``(n,)`` is, before its outcome is added."""
        mean, error = self.predict(action[None])
        self._squares.append(min((reward - float(mean[0])) / float(error[0]) * self._factor, WORST) ** 2)

    def nearest(self, actions: Float64s) -> Float64s:
        """Return the distances of actions ``(B, n)`` to the nearest simulated one ``(B,)`` [m]."""
        return self._distances(actions).min(axis=1)

    def owners(self, actions: Float64s) -> NDArray[np.intp]:
        """Return which simulation is nearest to each action ``(B,)``."""
        return self._distances(actions).argmin(axis=1)

    def predict(self, actions: Float64s) -> tuple[Float64s, Float64s]:
        """Return mean and standard deviation of the rewards of nearby actions ``(B, n)``, both ``(B,)`` [m]."""
        distances = self._distances(actions)
        weights, variances = self._weights(distances)
        mean = self._rewards(actions, weights)
        share = SHARE * len(self._surfaces[0]) / self._target.size
        squares = NOISE**2 + (FAR * distances.min(axis=1)) ** 2 + share**2 * self._variance * (variances + self._noise)
        return mean, self._factor * np.sqrt(squares)

    @property
    def _factor(self) -> float:
        """How far off predictions were, as a multiple of what was said."""
        return sqrt((TRUST + sum(self._squares)) / (TRUST + len(self._squares)))

    def _distances(self, actions: Float64s) -> Float64s:
        return np.stack([transport.distances(actions) for transport in self._transports], axis=1)

    def _fit(self) -> None:
        """Choose length scale and noise by the likelihood of the surfaces, whose mean is unknown."""
        count, likelihood = len(self._surfaces), -np.inf
        surfaces = np.stack(self._surfaces).astype(np.float64)
        surfaces -= surfaces.mean(axis=0)
        products = surfaces @ surfaces.T / surfaces.shape[1]
        distances = self._distances(np.stack(self._actions))
        for length in LENGTHS:
            correlations = _matern(distances / length)
            for noise in NOISES:
                try:
                    factor = cast(Float64s, np.linalg.cholesky(correlations + noise * np.eye(count)))
                except np.linalg.LinAlgError:  # distances along a circle are not Euclidean
                    continue
                whitening = cast(Float64s, np.linalg.inv(factor))
                inverse = whitening.T @ whitening
                ones = inverse.sum(axis=0)
                squares = (inverse * products).sum() - ones @ products @ ones / ones.sum()
                variance = (squares + SURFACE**2 / 2) / (count - 1 / 2)
                found = -INDEPENDENT / 2 * (
                    (count - 1 / 2) * np.log(variance) + 2 * np.log(np.diag(factor)).sum() + np.log(ones.sum())
                ) + _prior(length, noise)
                if found > likelihood:
                    likelihood = found
                    self._length, self._noise, self._variance, self._inverse = length, noise, variance, inverse

    def _weights(self, distances: Float64s) -> tuple[Float64s, Float64s]:
        """Return the weights ``(B, k)`` for distances ``(B, k)``, and variances as shares of the surface's ``(B,)``."""
        correlations = _matern(distances / self._length)
        known, ones = correlations @ self._inverse, self._inverse.sum(axis=0)
        rest = 1 - known.sum(axis=1)
        variances = 1 - (known * correlations).sum(axis=1) + rest**2 / ones.sum()
        return known + rest[:, None] * ones / ones.sum(), np.maximum(variances, 0)

    def _rewards(self, actions: Float64s, weights: Float64s) -> Float64s:
        """Return the rewards of the blended outcomes; beyond the item's reach they are the weightiest one's."""
        used = np.argsort(-np.abs(weights).sum(axis=0), kind="stable")[:MOST]
        chosen = weights[:, used]
        chosen[:, 0] += 1 - chosen.sum(axis=1)
        transports = [self._transports[index] for index in map(int, used)]
        windows = [transport.window(actions) for transport in transports]
        window = _hull([rows for rows, _ in windows]), _hull([columns for _, columns in windows])
        wanted = self._target[window]
        blended = np.zeros((len(actions), *wanted.shape), dtype=np.float32)
        shared: dict[Any, Any] = {}
        for transport, weight in zip(transports, chosen.T.astype(np.float32), strict=True):
            blended += weight[:, None, None] * transport.patches(actions, window, shared)
        still = np.abs(transports[0].outcome - self._target)
        rest = float(still.sum(dtype=np.float64) - still[window].sum(dtype=np.float64))
        blended -= wanted
        np.abs(blended, out=blended)
        return -(rest + blended.sum(axis=(1, 2), dtype=np.float64)) / self._target.size


def _matern(distances: Float64s) -> Float64s:
    scaled = sqrt(5) * distances
    return (1 + scaled * (1 + scaled / 3)) * np.exp(-scaled)


def _prior(length: float, noise: float) -> float:
    """Return the logarithm of the prior, log-normal in both."""
    likely_length, length_factor, likely_noise, noise_factor = PRIOR
    steps = np.log(length / likely_length) / np.log(length_factor), np.log(noise / likely_noise) / np.log(noise_factor)
    return -float(steps[0] ** 2 + steps[1] ** 2) / 2


def _hull(slices: list[slice]) -> slice:
    return slice(min(part.start for part in slices), max(part.stop for part in slices))
