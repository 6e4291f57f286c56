"""BoTorch's multi-fidelity knowledge gradient: cheap models and the trusted one as fidelities of one function.

Wu et al., 2019, as BoTorch's tutorial shows it, with discrete fidelities and the models' measured costs.
"""

from collections.abc import Iterator, Mapping
from typing import Any

import numpy as np

from common.planning.gp import Float64s
from common.planning.plan import Outcome, Plan, Setting
from common.planning.strategy import Query, Strategy
from common.planning.ucb import quasi_random
from pipelines.optimizers.botorch_planner import fitted, import_botorch, quiet, step_seed

FANTASIES, RESTARTS, RAW_SAMPLES = 16, 3, 32
"""Fewer than the tutorial's 128, 10 and 512: a step takes seconds even so."""
FIRST = 6
"""Actions at which the cheap models are asked before the model has a say."""


class FidelityStrategy(Strategy):
    """Ask any model where the knowledge gradient per cost is highest, the last time the trusted one at the best action.

    Args:
        calls: Largest number of calls of the trusted model.
        costs: What a call of each model takes, by name [s].
    """

    def __init__(self, calls: int, costs: Mapping[str, float]) -> None:
        self.name = f"botorch:mfkg:calls={calls}"
        self._calls = calls
        self._costs = costs
        import_botorch()

    def required(self, trusted: str) -> str:
        """Return the trusted model."""
        return trusted

    def order(self, query: Query) -> Iterator[str]:
        """Yield the trusted model; cheap ones are asked by the plan."""
        yield query.trusted

    def plan(self, setting: Setting) -> Plan:
        """Return the course of an optimisation."""
        return FidelityPlan(setting, costs=self._costs)

    def budget(self, evaluations: int) -> int:
        """Return the number of calls."""
        return min(self._calls, evaluations)


class FidelityPlan(Plan):
    """One optimisation; only outcomes of the trusted model are trials.

    Args:
        setting: The optimisation.
        costs: What a call of each model takes, by name [s].
    """

    MOST = 50
    """Questions to all models together."""

    def __init__(self, setting: Setting, *, costs: Mapping[str, float]) -> None:
        self._setting = setting
        self._models = (*setting.cheap, setting.trusted)
        self._costs = [max(costs.get(model, 0.0), 1e-4) for model in self._models]
        self._lower, self._range = setting.problem.limits[:, 0], np.ptp(setting.problem.limits, axis=1)
        self._points: list[Float64s] = []
        self._rewards: list[float] = []
        self._asked: list[Float64s] = []

    def ask(self) -> Float64s | None:
        """Return the next action for the trusted model ``(n,)``."""
        self._asked.append(self._next())
        return self._lower + self._asked[-1] * self._range

    def tell(self, index: int, outcome: Outcome | None) -> None:
        """Learn the trusted model's reward."""
        if outcome is not None:
            self._keep(self._asked[index], len(self._models) - 1, outcome.reward)

    def _next(self) -> Float64s:
        dimensions = len(self._lower)
        if not self._asked:
            shift = np.random.default_rng(self._setting.seed).random(dimensions)
            first = (quasi_random(FIRST, dimensions) + shift) % 1
            for point in first:
                for model in range(len(self._models) - 1):
                    self._sweep(point, model)
            return first[0] if not self._rewards else first[int(np.argmax(self._rewards[-FIRST:]))]
        while len(self._asked) < self._setting.evaluations - 1 and len(self._points) < self.MOST:
            point, model = self._best_question()
            if model == len(self._models) - 1 or not self._sweep(point, model):
                return point
        return self._best_mean()

    def _sweep(self, point: Float64s, model: int) -> bool:
        """Ask a cheap model; return whether it answered."""
        found = self._setting.survey.rewards(self._models[model], (self._lower + point * self._range)[None])
        if found is not None:
            self._keep(point, model, float(found[0]))
        return found is not None

    def _keep(self, point: Float64s, model: int, reward: float) -> None:
        self._points.append(np.append(point, self._fidelity(model)))
        self._rewards.append(reward)

    def _fidelity(self, model: int) -> float:
        return model / max(len(self._models) - 1, 1)

    def _best_question(self) -> tuple[Float64s, int]:
        botorch = import_botorch()
        import torch
        from botorch.acquisition.cost_aware import InverseCostWeightedUtility
        from botorch.acquisition.knowledge_gradient import qMultiFidelityKnowledgeGradient
        from botorch.acquisition.utils import project_to_target_fidelity
        from botorch.models.deterministic import GenericDeterministicModel

        fidelities = torch.tensor([self._fidelity(model) for model in range(len(self._models))], dtype=torch.float64)
        costs = torch.tensor(self._costs, dtype=torch.float64)
        last = len(self._lower)

        def cost(points: Any) -> Any:
            return costs[(points[..., -1:] - fidelities).abs().argmin(dim=-1)][..., None]

        with quiet(), botorch.manual_seed(step_seed(self._setting.seed, len(self._points))):
            model = self._model()
            acquisition = qMultiFidelityKnowledgeGradient(
                model,
                num_fantasies=FANTASIES,
                current_value=self._mean_maximum(model)[1],
                cost_aware_utility=InverseCostWeightedUtility(GenericDeterministicModel(cost)),
                project=lambda points: project_to_target_fidelity(points, target_fidelities={last: 1.0}, d=last + 1),
            )
            found, _ = botorch.optim.optimize_acqf_mixed(
                acquisition,
                bounds=torch.tensor([[0.0] * (last + 1), [1.0] * (last + 1)], dtype=torch.float64),
                fixed_features_list=[{last: float(fidelity)} for fidelity in fidelities],
                q=1,
                num_restarts=RESTARTS,
                raw_samples=RAW_SAMPLES,
                options={"batch_limit": 5, "maxiter": 50},
            )
        point = found[0].detach().numpy()
        return point[:-1], int(np.abs(fidelities.numpy() - point[-1]).argmin())

    def _best_mean(self) -> Float64s:
        botorch = import_botorch()
        with quiet(), botorch.manual_seed(step_seed(self._setting.seed, len(self._points))):
            return self._mean_maximum(self._model())[0].detach().numpy()[0]

    def _model(self) -> Any:
        import torch
        from botorch.models import SingleTaskMultiFidelityGP

        points = torch.from_numpy(np.stack(self._points))
        rewards = torch.tensor(self._rewards, dtype=torch.float64)[:, None]
        return fitted(SingleTaskMultiFidelityGP, points, rewards, data_fidelities=[len(self._lower)])

    def _mean_maximum(self, model: Any) -> tuple[Any, Any]:
        """Return where the trusted model's expected reward is highest ``(1, n)``, and that reward."""
        import torch
        from botorch.acquisition import PosteriorMean
        from botorch.acquisition.fixed_feature import FixedFeatureAcquisitionFunction

        last = len(self._lower)
        mean = FixedFeatureAcquisitionFunction(PosteriorMean(model), d=last + 1, columns=[last], values=[1.0])
        cube = torch.tensor([[0.0] * last, [1.0] * last], dtype=torch.float64)
        return import_botorch().optim.optimize_acqf(mean, bounds=cube, q=1, num_restarts=RESTARTS, raw_samples=128)
