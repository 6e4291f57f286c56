"""The same planner with scikit-learn's regressor in place of our own Gaussian process: slower, and the reference."""

import warnings
from importlib import import_module
from importlib.util import find_spec
from typing import Any

import numpy as np
from numpy.typing import NDArray

from common.domain.errors import RequestError
from common.planning.gp import Float64s
from common.planning.planner import INITIAL, NOISE, SCALE_MEDIAN, Belief, Planner
from common.planning.space import embed

SCALE_LIMITS, NOISE_LIMITS = (0.03, 1.0), (1e-6, 1e-2)
"""Between which length scale and noise are fitted."""


class SklearnPlanner(Planner):
    """GP-UCB whose length scale and noise are fitted in every step by maximum likelihood.

    A pending or failed action counts as if its expected reward had come, which leaves the mean as it is and takes the
    uncertainty away, as in GP-BUCB.

    Raises:
        RequestError: The bounds are no bounds, or scikit-learn is not installed.
    """

    def __init__(
        self,
        bounds: NDArray[np.float64],
        *,
        seed: int,
        initial: int = INITIAL,
        circular: NDArray[np.bool_] | None = None,
    ) -> None:
        if find_spec("sklearn") is None:
            raise RequestError(
                "scikit-learn: expected it to be installed, got none; run pip install -e '.[bench]' in the checkout"
            )
        super().__init__(bounds, seed=seed, initial=initial, circular=circular)

    def _belief(self) -> Belief:
        points = embed(np.stack(self._points), self._circular)
        told = points[[*self._rewards]]
        untold = [point for index, point in enumerate(points) if index not in self._rewards]
        process = _fitted(told, np.array([*self._rewards.values()]))
        if untold:
            believed = process.predict(np.stack(untold))
            process = _fitted(
                np.concatenate([told, untold]), np.array([*self._rewards.values(), *believed]), process.kernel_
            )

        def belief(points: Float64s | None) -> tuple[Float64s, Float64s]:
            seen = embed(self._candidates if points is None else points, self._circular)
            return process.predict(seen, return_std=True)

        return belief


def _fitted(points: Float64s, rewards: Float64s, kernel: Any = None) -> Any:
    """Return a regressor of rewards ``(N,)`` at points ``(N, n)``, with a kernel as it is, or a fitted one if None."""
    process, kernels = import_module("sklearn.gaussian_process"), import_module("sklearn.gaussian_process.kernels")
    optimizer = "fmin_l_bfgs_b" if kernel is None else None
    if kernel is None:
        scale, noise = kernels.Matern(SCALE_MEDIAN, SCALE_LIMITS, nu=2.5), kernels.WhiteKernel(NOISE, NOISE_LIMITS)
        kernel = kernels.ConstantKernel() * scale + noise
    regressor = process.GaussianProcessRegressor(kernel, normalize_y=True, optimizer=optimizer)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", import_module("sklearn.exceptions").ConvergenceWarning)
        return regressor.fit(points, rewards)
