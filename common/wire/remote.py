"""Models and estimators that run in worker processes, behind the same front as local ones."""

import numpy as np
from numpy.typing import NDArray

from common.domain.deviation import DeviationEstimator, Estimates
from common.domain.errors import ModelError
from common.domain.grid import Floats
from common.domain.model import Predictions, PredictiveModel, check_actions
from common.domain.scene import State
from common.wire.directory import Directory
from common.wire.dispatch import Limits, Question, dispatch
from common.wire.messages import Card, EstimateReply, EstimateRequest, PredictReply, PredictRequest


class RemoteModel(PredictiveModel):
    """A model that live workers run. Safe to use from several threads at once.

    Its predictions name the worker and the time it computed; their events' times count from the call's beginning.

    Args:
        directory: Who is alive.
        name: The model.
        limits: How long calls may take.

    Raises:
        UnavailableError: No worker of this model is alive.
    """

    def __init__(self, directory: Directory, name: str, *, limits: Limits) -> None:
        card = _card(directory.wait_for("model", name)[0].card)
        self.name = name
        self.version = card.version
        self.largest_batch = card.largest_batch
        self.takes = _takes(card)
        self._directory = directory
        self._limits = limits

    def outcomes(self, state: State, actions: NDArray[np.float64]) -> tuple[Floats, tuple[str, ...]]:
        """Return heightmaps ``(B, H, W)`` [m] and warnings from a worker."""
        predictions = self.predict(state, actions)
        return predictions.heights, predictions.warnings

    def predict(self, state: State, actions: Floats) -> Predictions:
        """Predict the outcome of every action on the least loaded worker; errors as in `dispatch`."""
        checked = check_actions(actions, self.largest_batch, self.takes)
        expected = (len(checked), *state.grid.shape)

        def check(reply: PredictReply) -> None:
            heights = reply.heights
            if heights.shape != expected or heights.dtype == "bool" or len(reply.warnings) != len(checked):
                raise ModelError(
                    f"{self.name}/{reply.instance}: expected heightmaps {expected} and {len(checked)} warnings, "
                    f"got {heights.dtype} {heights.shape} and {len(reply.warnings)}"
                )
            if not np.isfinite(heights.values()).all():
                raise ModelError(f"{self.name}/{reply.instance}: expected finite heights, got NaN or infinite ones")

        request = PredictRequest.of(state, checked, content=False)
        question = Question(
            role="model",
            model=self.name,
            leaf="predict",
            request=request,
            content=lambda: request.carrying(state),
            grid=state.grid,
            batch=len(checked),
            reply=PredictReply,
            check=check,
        )
        answer = dispatch(self._directory, question, self._limits)
        reply = answer.reply
        self._directory.record(
            answer.address,
            digest=state.digest,
            batch=len(checked),
            compute_s=reply.compute_s,
            load=reply.load,
            version=reply.version,
        )
        return Predictions(
            heights=np.asarray(reply.heights.values(), dtype=np.float32),
            warnings=reply.warnings,
            model=self.name,
            version=reply.version,
            instance=answer.address.instance,
            compute_s=min(reply.compute_s, answer.seconds),
            events=answer.events,
        )


class RemoteEstimator(DeviationEstimator):
    """An MDE that live workers run; everything as in `RemoteModel`.

    ``version`` is that of one worker when it was made. Workers may take other weights over at any time: each answer
    tells the version that gave it.
    """

    def __init__(self, directory: Directory, model: str, *, limits: Limits) -> None:
        card = _card(directory.wait_for("mde", model)[0].card)
        self.model = model
        self.version = card.version
        self.largest_batch = card.largest_batch
        self.takes = _takes(card)
        self._directory = directory
        self._limits = limits

    def deviations(self, state: State, actions: NDArray[np.float64]) -> Estimates:
        """Return the estimates for actions ``(B, 2)`` [m] from a worker."""
        return self.estimate(state, actions)

    def estimate(self, state: State, actions: Floats) -> Estimates:
        """Estimate the deviation of every action on the least loaded worker; errors as in `dispatch`."""
        checked = check_actions(actions, self.largest_batch, self.takes)

        def check(reply: EstimateReply) -> None:
            for name in ("mean", "upper", "familiar"):
                values = getattr(reply, name)
                if values.shape != (len(checked),) or not np.isfinite(values.values()).all():
                    raise ModelError(
                        f"MDE of {self.model}/{reply.instance}: expected {len(checked)} finite numbers as {name}, "
                        f"got shape {values.shape}"
                    )

        request = EstimateRequest.of(state, checked, content=False)
        question = Question(
            role="mde",
            model=self.model,
            leaf="estimate",
            request=request,
            content=lambda: request.carrying(state),
            grid=state.grid,
            batch=len(checked),
            reply=EstimateReply,
            check=check,
        )
        answer = dispatch(self._directory, question, self._limits)
        reply = answer.reply
        self._directory.record(
            answer.address,
            digest=state.digest,
            batch=len(checked),
            compute_s=reply.compute_s,
            load=reply.load,
            version=reply.version,
        )
        return Estimates(
            mean=np.asarray(reply.mean.values(), dtype=np.float64),
            upper=np.asarray(reply.upper.values(), dtype=np.float64),
            familiar=np.asarray(reply.familiar.values(), dtype=np.bool_),
            reason=reply.reason,
            instance=answer.address.instance,
            compute_s=min(reply.compute_s, answer.seconds),
            events=answer.events,
            scale_m=reply.scale_m,
            version=reply.version,
        )


def _card(card: Card | None) -> Card:
    if card is None:
        raise AssertionError("the directory waits for workers with cards")
    return card


def _takes(card: Card) -> tuple[tuple[str, ...], ...]:
    return (card.parameters,) if card.parameters else ()
