"""Predictive models and estimators as workers."""

import logging
import time
from collections.abc import Callable
from typing import Any

import numpy as np
import zenoh
from numpy.typing import NDArray

from common.domain.deviation import DeviationEstimator
from common.domain.errors import ModelError, RequestError
from common.domain.grid import Grid
from common.domain.model import PredictiveModel, check_parameters
from common.domain.scene import State
from common.wire.call import Call
from common.wire.codec import MAX_REPLY_BYTES
from common.wire.cost import CostMeter
from common.wire.endpoint import Endpoint
from common.wire.host import Host
from common.wire.messages import (
    Card,
    EstimateReply,
    EstimateRequest,
    LoadReply,
    LoadRequest,
    PredictReply,
    PredictRequest,
    StateRequest,
    new_id,
)
from common.wire.state import GridMessage
from common.wire.states import StateCache

log = logging.getLogger(__name__)

Work = tuple[State, NDArray[np.float64]]
Loader = Callable[[bytes, bytes], tuple[DeviationEstimator, str]]
"""Makes an estimator from a card and tensors, and tells the weights' SHA-256; raises `ModelError` if they are wrong."""


def host_model(
    session: zenoh.Session,
    model: PredictiveModel,
    *,
    task: str,
    instance: str | None = None,
    weights: str | None = None,
    device: str = "cpu",
    grid: Grid | None = None,
    parameters: tuple[str, ...] = (),
    queue_length: int = 16,
) -> Host:
    """Return a worker that predicts with ``model``; one batch is one computation, one at a time.

    Args:
        session: The session to serve on.
        model: The model.
        task: The task whose states it takes.
        instance: Name of this process, a new one if None.
        weights: SHA-256 of its weights.
        device: What it computes on.
        grid: The only grid that it takes, None: any.
        parameters: Names of the parameters of the task's actions; empty: those of the only form that it takes.
        queue_length: Requests that may wait; more are answered ``busy``.
    """
    meter, name = CostMeter(), instance or new_id()[:8]

    def predict(work: Work, call: Call) -> PredictReply:
        state, actions = work
        began = time.perf_counter()
        predictions = model.predict(state, actions)
        compute_s = time.perf_counter() - began
        meter.record(len(actions), compute_s)
        reply = PredictReply.of(predictions, instance=name, compute_s=compute_s)
        return reply.model_copy(update={"load": call.waiting()})

    card = Card(
        task=task,
        role="model",
        model=model.name,
        instance=name,
        version=model.version,
        weights=weights,
        device=device,
        grid=grid and GridMessage.of(grid),
        largest_batch=model.largest_batch,
        parameters=_parameters(parameters, model.takes),
    )
    endpoint = Endpoint("predict", PredictRequest, predict, Preparation(card, StateCache()), identity)
    return Host(session, card, [endpoint], queue_length=queue_length, meter=meter)


def host_estimator(
    session: zenoh.Session,
    estimator: DeviationEstimator,
    *,
    task: str,
    instance: str | None = None,
    weights: str | None = None,
    device: str = "cpu",
    grid: Grid | None = None,
    parameters: tuple[str, ...] = (),
    queue_length: int = 1024,
    load: Loader | None = None,
) -> Host:
    """Return a worker that estimates deviations; arguments as in `host_model`.

    With ``load``, which makes an estimator and its weights' SHA-256 from a card and tensors, the worker takes other
    weights over while it serves: requests that are begun after that, those that wait too, are answered with them. What
    has begun ends with the weights before. They are read on a thread of its own, so that neither waits for the other.
    """
    meter, name = CostMeter(), instance or new_id()[:8]
    serving = [(estimator, weights)]

    def estimate(work: Work, call: Call) -> EstimateReply:
        (state, actions), (chosen, digest) = work, serving[0]
        began = time.perf_counter()
        estimates = chosen.estimate(state, actions)
        compute_s = time.perf_counter() - began
        meter.record(len(actions), compute_s)
        reply = EstimateReply.of(estimates, model=chosen.model, instance=name, compute_s=compute_s, weights=digest)
        return reply.model_copy(update={"load": call.waiting()})

    def take_over(request: LoadRequest, call: Call) -> LoadReply:
        del call
        assert load is not None
        found, digest = load(request.card, request.tensors)
        served = serving[0][0]
        _check_alike(found, served)
        serving[0] = found, digest
        host.update_card(version=found.version, weights=digest)
        log.info("%s: version %s instead of %s", host.address.worker, found.version, served.version)
        return LoadReply(
            model=found.model, version=found.version, previous=served.version, weights=digest, instance=name
        )

    card = Card(
        task=task,
        role="mde",
        model=estimator.model,
        instance=name,
        version=estimator.version,
        weights=weights,
        device=device,
        grid=grid and GridMessage.of(grid),
        largest_batch=estimator.largest_batch,
        parameters=_parameters(parameters, estimator.takes),
    )
    endpoints = [Endpoint("estimate", EstimateRequest, estimate, Preparation(card, StateCache()), identity)]
    if load is not None:
        endpoints.append(Endpoint("load", LoadRequest, take_over, exact=True, apart=True))
    host = Host(session, card, endpoints, queue_length=queue_length, meter=meter)
    return host


class Preparation:
    """Finds the state that a request names and reads its actions, before it waits in the queue."""

    def __init__(self, card: Card, states: StateCache) -> None:
        self._card = card
        self._states = states

    def __call__(self, request: StateRequest) -> Work:
        """Return state and actions ``(B, n)``.

        Raises:
            UnknownStateError: The request names a state that is not here.
            RequestError: State or actions are wrong, or the answer would be too large.
        """
        actions = request.actions.values()
        if actions.ndim != 2 or actions.dtype == np.bool_ or not 1 <= len(actions) <= self._card.largest_batch:
            raise RequestError(
                f"actions: expected numbers of shape (B, n) with B from 1 to {self._card.largest_batch}, "
                f"got {request.actions.dtype} of shape {actions.shape}"
            )
        check_parameters(actions.shape[1], (self._card.parameters,) if self._card.parameters else ())
        state = self._states.resolve(request.state, request.content)
        grid = self._card.grid
        if grid is not None and grid.grid() != state.grid:
            raise RequestError(f"grid: expected {grid.grid()}, got {state.grid}")
        if self._card.role == "model" and 4 * len(actions) * state.grid.rows * state.grid.columns > MAX_REPLY_BYTES:
            raise RequestError(
                f"actions: expected heightmaps of at most {MAX_REPLY_BYTES} bytes together, "
                f"got {len(actions)} of {state.grid.rows} x {state.grid.columns} cells"
            )
        return state, np.asarray(actions, dtype=np.float64)


def _check_alike(found: DeviationEstimator, served: DeviationEstimator) -> None:
    """Raise `ModelError` if an estimator does not take the requests that are prepared for another one."""
    for what in ("model", "takes", "largest_batch"):
        expected, got = getattr(served, what), getattr(found, what)
        if got != expected:
            raise ModelError(f"{what}: expected {expected} as of the MDE that is served, got {got}")


def _parameters(names: tuple[str, ...], takes: tuple[tuple[str, ...], ...]) -> tuple[str, ...]:
    """Return the parameters to put on a card: those of the task, else the only ones that are taken, else none."""
    return names or (takes[0] if len(takes) == 1 else ())


def identity(request: StateRequest) -> tuple[Any, ...] | None:
    """Return what makes two requests the same: id, state and actions; None if the state has no name."""
    if request.state is None:
        return None
    return request.id, request.state, request.actions.dtype, request.actions.shape, request.actions.data
