"""One evaluation: choose a model for an action, predict the outcome, reward it, account for the time."""

from collections import defaultdict
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from common.domain.deviation import DeviationEstimator
from common.domain.errors import BusyError, CancelledError, FrugalError, ModelError, UnavailableError
from common.domain.model import Event, Predictions, PredictiveModel
from common.domain.trial import Trial
from common.planning.estimation import RECOVERABLE, Round, failure_event
from common.planning.problem import Problem
from common.planning.strategy import Estimate, Query, Strategy


@dataclass(frozen=True)
class Evaluation:
    """One evaluated action with everything that came with it.

    Attributes:
        trial: The evidence.
        heights: Predicted heightmap ``(H, W)`` [m]; None if no model could predict it.
        split_s: Time by model, and for ``mde``, ``optimiser`` and ``transport`` [s].
        events: What went wrong on the way.
        failure: Why there is no reward; None if there is one.
    """

    trial: Trial
    heights: NDArray[np.float32] | None
    split_s: Mapping[str, float]
    events: tuple[Event, ...]
    failure: FrugalError | None = None


def elapsed_s(evaluations: Mapping[int, Evaluation]) -> float:
    """Return how far a run had come when the last of its evaluations ended [s]; 0 if there is none."""
    return max((known.trial.started_s + known.trial.predict_s for known in evaluations.values()), default=0.0)


@dataclass(frozen=True)
class Evaluator:
    """Evaluates actions of one optimisation; safe to call from several threads at once.

    Attributes:
        problem: What is to be optimised.
        models: Models by name, from cheapest to dearest.
        estimators: MDEs by the name of their model.
        strategy: How to choose.
        trusted: The model that is always applicable.
        d_max: Deviation below which a model is applicable.
        seed: Seed of the optimisation.
        now: Seconds since the optimisation began.
        stopped: Whether nobody waits for answers any more.
        earlier: Evaluations of an interrupted run by index: nobody is asked again for these.
        on_evaluation: Called with every other one as soon as it is known, from the thread that made it.
    """

    problem: Problem
    models: Mapping[str, PredictiveModel]
    estimators: Mapping[str, DeviationEstimator]
    strategy: Strategy
    trusted: str
    d_max: float
    seed: int
    now: Callable[[], float]
    stopped: Callable[[], bool]
    earlier: Mapping[int, Evaluation] = field(default_factory=dict[int, Evaluation])
    on_evaluation: Callable[[Evaluation], None] | None = None

    def round(self, actions: NDArray[np.float64]) -> Round:
        """Return a round of actions ``(B, n)`` that are evaluated together."""
        return Round(self.problem.state, actions, self.estimators, now=self.now)

    def evaluate(self, index: int, action: NDArray[np.float64], together: Round, position: int) -> Evaluation:
        """Evaluate one action ``(n,)`` of a round: try the strategy's models in turn until one answers.

        A model that fails is an event, and the next one is asked. If the last one fails too, the evaluation
        counts as failed.

        Raises:
            RequestError: A model or an MDE refused the request; every other one would.
            CancelledError: The optimisation has ended meanwhile, or a model was told so.
            UnavailableError: Nobody serves the last model of the strategy.
        """
        known, misfit = self.earlier.get(index), ""
        if known is not None:
            misfit = self._misfit(known.trial, action)
            if not misfit:
                return known
        made = _Attempt(self, index, action, together, position).run()
        if known is not None:
            event = Event("not_resumed", f"{known.trial.model}/{known.trial.instance}", misfit, made.trial.started_s)
            made = replace(made, events=(event, *made.events))
        if self.on_evaluation is not None:
            self.on_evaluation(made)
        return made

    def _misfit(self, trial: Trial, action: NDArray[np.float64]) -> str:
        """Return why an earlier trial does not tell what comes of an action ``(n,)``; empty if it does."""
        asked = tuple(action.tolist())
        if trial.action != asked:
            return f"evaluation {trial.index}: expected the action {trial.action} of the interrupted run, got {asked}"
        model = self.models.get(trial.model)
        if model is not None and trial.version and trial.version != model.version:
            return f"evaluation {trial.index}: expected version {trial.version} of {trial.model}, got {model.version}"
        return ""


class _Attempt:
    """The tally of one evaluation."""

    def __init__(
        self, evaluator: Evaluator, index: int, action: NDArray[np.float64], together: Round, position: int
    ) -> None:
        self._evaluator = evaluator
        self._index = index
        self._action = action
        self._round = together
        self._position = position
        self._started = evaluator.now()
        self._split: defaultdict[str, float] = defaultdict(float)
        self._events: list[Event] = []
        self._estimates: dict[str, Estimate | None] = {}

    def run(self) -> Evaluation:
        owner, model = self._evaluator, ""
        failure: FrugalError = ModelError(f"strategy {owner.strategy.name}: expected at least one model, got none")
        for model in owner.strategy.order(self._query()):
            if owner.stopped():
                raise CancelledError("the optimisation has ended")
            if model == owner.trusted:
                self._estimate(model)  # it stays applicable; the trial tells how far it may be from the world
            began = owner.now()
            try:
                predictions = owner.models[model].predict(owner.problem.state, self._action[None])
            except RECOVERABLE as error:
                failure = error
                self._split["transport"] += owner.now() - began
                self._record(error, model)
            else:
                return self._success(model, predictions, owner.now() - began)
        if isinstance(failure, UnavailableError) and not isinstance(failure, BusyError):
            raise failure
        trial = self._trial(model, reward=None, error=f"{failure.code}: {failure}")
        return Evaluation(trial, None, self._split, tuple(self._events), failure)

    def _success(self, model: str, predictions: Predictions, wall_s: float) -> Evaluation:
        owner = self._evaluator
        compute_s = wall_s if predictions.compute_s is None else min(predictions.compute_s, wall_s)
        self._split[model] += compute_s
        self._split["transport"] += wall_s - compute_s
        self._gather(predictions.events)
        heights, began = predictions.heights[0], owner.now()
        reward = float(owner.problem.task.reward(heights, owner.problem.target))
        self._split["optimiser"] += owner.now() - began
        trial = self._trial(
            model,
            reward=reward,
            instance=predictions.instance,
            version=predictions.version,
            warning=predictions.warnings[0],
            compute_s=compute_s,
        )
        return Evaluation(trial, heights, self._split, tuple(self._events))

    def _trial(
        self,
        model: str,
        *,
        reward: float | None,
        instance: str = "",
        version: str = "",
        warning: str = "",
        compute_s: float = 0.0,
        error: str = "",
    ) -> Trial:
        known = {name: estimate for name, estimate in self._estimates.items() if estimate is not None}
        return Trial(
            index=self._index,
            action=tuple(self._action.tolist()),
            model=model,
            instance=instance,
            version=version,
            reward=reward,
            estimates={name: estimate.mean for name, estimate in known.items()},
            warning=warning,
            started_s=self._started,
            predict_s=self._evaluator.now() - self._started,
            compute_s=compute_s,
            error=error,
            uppers={name: estimate.upper for name, estimate in known.items()},
            unfamiliar=tuple(name for name, estimate in known.items() if not estimate.familiar),
            mdes={name: estimate.version for name, estimate in known.items() if estimate.version},
        )

    def _query(self) -> Query:
        owner = self._evaluator
        return Query(
            index=self._index,
            models=tuple(owner.models),
            estimable=frozenset(owner.estimators),
            trusted=owner.trusted,
            d_max=owner.d_max,
            seed=owner.seed,
            estimate=self._estimate,
        )

    def _estimate(self, model: str) -> Estimate | None:
        if model not in self._evaluator.estimators or model in self._estimates:
            return self._estimates.get(model)
        told = self._round.consult(model, self._position)
        self._split["mde"] += told.compute_s
        self._split["transport"] += told.transport_s
        self._gather(told.events)
        self._estimates[model] = told.estimate
        return told.estimate

    def _record(self, error: FrugalError, worker: str) -> None:
        self._gather((failure_event(error, worker),))

    def _gather(self, events: tuple[Event, ...]) -> None:
        self._events += [replace(event, time=self._evaluator.now()) for event in events]
