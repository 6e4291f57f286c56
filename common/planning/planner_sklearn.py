"""The same planner with scikit-learn's regressor in place of our own Gaussian process: slower, and the reference."""

import warnings
from importlib.util import find_spec
from typing import Any

import numpy as np
from numpy.typing import NDArray

from common.domain.errors import RequestError
from common.planning.gp import Float64s
from common.planning.planner import NOISE, SCALE_MEDIAN, Belief, Planner

SCALE_LIMITS, NOISE_LIMITS = (0.03, 1.0), (1e-6, 1e-2)
"""Between which length scale and noise are fitted."""


class SklearnPlanner(Planner):
    """GP-UCB whose length scale and noise are fitted in every step by maximum likelihood.

    A pending or failed action counts as if its expected reward had come, which leaves the mean as it is and takes the
    uncertainty away, as in GP-BUCB.

    Raises:
        RequestError: The bounds are no bounds, or scikit-learn is not installed.
    """

    def __init__(self, bounds: NDArray[np.float64], *, seed: int) -> None:
        if find_spec("sklearn") is None:
            raise RequestError(
                "scikit-learn: expected it to be installed, got none; run pip install -e '.[bench]' in the checkout"
            )
        super().__init__(bounds, seed=seed)

    def _belief(self) -> Belief:
        from sklearn.exceptions import ConvergenceWarning
        from sklearn.gaussian_process import GaussianProcessRegressor
        from sklearn.gaussian_process.kernels import ConstantKernel, Matern, WhiteKernel

        points, rewards = np.stack([self._points[index] for index in self._rewards]), [*self._rewards.values()]
        kernel = ConstantKernel() * Matern(SCALE_MEDIAN, SCALE_LIMITS, nu=2.5) + WhiteKernel(NOISE, NOISE_LIMITS)
        process: Any = GaussianProcessRegressor(kernel, normalize_y=True)
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", ConvergenceWarning)
            process.fit(points, rewards)
        untold = [point for index, point in enumerate(self._points) if index not in self._rewards]
        if untold:
            more = np.stack(untold)
            process = GaussianProcessRegressor(process.kernel_, optimizer=None, normalize_y=True).fit(
                np.concatenate([points, more]), [*rewards, *process.predict(more)]
            )

        def belief(wanted: Float64s | None) -> tuple[Float64s, Float64s]:
            mean, deviation = process.predict(self._candidates if wanted is None else wanted, return_std=True)
            return mean, deviation

        return belief
