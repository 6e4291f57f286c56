"""BoTorch's default loop behind our `Planner`: the same first actions, then its model and its acquisition function.

As its documentation shows it: `SingleTaskGP` on normalised actions and standardised rewards, fitted by maximum a
posteriori in every step, and `optimize_acqf` with several restarts.
"""

import warnings
from contextlib import AbstractContextManager
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from common.domain.errors import RequestError
from common.planning.gp import Float64s
from common.planning.planner import BETA, INITIAL, Planner

RESTARTS, RAW_SAMPLES = 10, 512
"""Of `optimize_acqf`."""


class BotorchPlanner(Planner):
    """Expected improvement or upper confidence bound by BoTorch, one action at a time, on one thread.

    Args:
        bounds: Smallest and largest value of each action parameter ``(n, 2)``.
        seed: Seed of the initial actions and of the restarts.
        acquisition: ``logei`` or ``ucb``, this with our beta.
        initial: Number of actions asked before the model has a say.
        circular: Which parameters are circles; BoTorch's kernel takes them for intervals.

    Raises:
        RequestError: The bounds are no bounds, or BoTorch is not installed.
    """

    def __init__(
        self,
        bounds: NDArray[np.float64],
        *,
        seed: int,
        acquisition: Literal["logei", "ucb"],
        initial: int = INITIAL,
        circular: NDArray[np.bool_] | None = None,
    ) -> None:
        super().__init__(bounds, seed=seed, initial=initial, circular=circular)
        self._seed = seed
        self._acquisition = acquisition
        import_botorch()

    def _highest_bound(self) -> Float64s:
        if len(self._rewards) + len(self._failed) < len(self._points):
            raise RequestError("BoTorch's planner: expected every action to be told before the next is asked, got more")
        botorch = import_botorch()
        import torch
        from botorch.acquisition import LogExpectedImprovement, UpperConfidenceBound

        points = torch.from_numpy(np.stack([self._points[index] for index in self._rewards]))
        rewards = torch.tensor([*self._rewards.values()], dtype=torch.float64)[:, None]
        with quiet(), botorch.manual_seed(step_seed(self._seed, len(self._points))):
            model = fitted(botorch.models.SingleTaskGP, points, rewards)
            if self._acquisition == "logei":
                acquisition = LogExpectedImprovement(model, best_f=rewards.max())
            else:
                acquisition = UpperConfidenceBound(model, beta=BETA)
            cube = torch.stack([torch.zeros_like(points[0]), torch.ones_like(points[0])])
            found, _ = botorch.optim.optimize_acqf(
                acquisition, bounds=cube, q=1, num_restarts=RESTARTS, raw_samples=RAW_SAMPLES
            )
        return found[0].detach().numpy()


def import_botorch() -> Any:
    """Return BoTorch, computing on one thread.

    Raises:
        RequestError: It is not installed.
    """
    try:
        with quiet():
            import botorch
            import botorch.fit
            import botorch.models
            import botorch.optim
            import torch
    except ModuleNotFoundError as error:
        raise RequestError(
            f"BoTorch: expected it to be installed, got {error}; run pip install -e '.[bench]' in the checkout"
        ) from None
    torch.set_num_threads(1)
    return botorch


def fitted(model: Any, points: Any, rewards: Any, **options: Any) -> Any:
    """Return a BoTorch model of rewards ``(N, 1)`` at points ``(N, n)``, with its own priors and standardisation."""
    from botorch.fit import fit_gpytorch_mll
    from botorch.models.transforms import Standardize
    from gpytorch.mlls import ExactMarginalLogLikelihood

    process = model(points, rewards, outcome_transform=Standardize(1), **options)
    fit_gpytorch_mll(ExactMarginalLogLikelihood(process.likelihood, process))
    return process


def quiet() -> AbstractContextManager[object]:
    """Return a context in which nothing warns: neither of old interfaces nor of fits that ended early."""
    return warnings.catch_warnings(action="ignore")


def step_seed(seed: int, step: int) -> int:
    """Return the seed of one step."""
    return int(np.random.SeedSequence([seed, step]).generate_state(1)[0])
