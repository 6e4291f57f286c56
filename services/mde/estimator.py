"""The released MDEs as estimators: a network, calibrated, with what its training data covers."""

import threading
from collections import OrderedDict
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import torch
from numpy.typing import NDArray

from common.domain.deviation import DeviationEstimator, Estimates
from common.domain.errors import ModelError
from common.domain.scene import State
from common.learning.weights import CARD, parse_card
from services.mde.ensemble import Calibrated, Inference, load_ensemble, parse_ensemble
from services.mde.network import Encoding, inputs

STATES = 32
"""States whose encodings are kept."""

CHUNK = 64
"""Actions that are computed together."""

BEYOND = "action: expected one within {:.0f} mm of the plate's centre, got one at {:.0f} mm"
FAR = "action: expected a situation like those of the training data, got one at {:.2f} times the largest distance"


@dataclass(frozen=True)
class _Known:
    """What depends on the state alone."""

    encodings: Sequence[Encoding]
    complaint: str


class NetworkEstimator(DeviationEstimator):
    """Estimates by networks; what depends on the state alone is computed once and kept for the last `STATES` states.

    A state of another grid gets the estimate 1; it and every state that differs from the training data, and every
    action in a situation far from it, is unfamiliar. Safe to use from several threads at once.

    Attributes:
        weights: SHA-256 of the weights in hex.
        grid: The grid of the training data.
        scale_m: The deviation that counts as 1 [m].

    Args:
        calibrated: The loaded weights.
    """

    largest_batch = 4096

    def __init__(self, calibrated: Calibrated) -> None:
        self.model = calibrated.card.name.removeprefix("mde_")
        self.version = calibrated.card.version
        self.weights = calibrated.card.sha256
        self.grid = calibrated.familiarity.grid
        self._calibrated = calibrated
        self.scale_m = calibrated.card.deviation_scale_m
        self._inference = Inference(calibrated.ensemble)
        self._known: OrderedDict[str, _Known] = OrderedDict()
        self._turn = threading.Lock()

    def deviations(self, state: State, actions: NDArray[np.float64]) -> Estimates:
        """Return mean and upper bound in [0, 1] for actions ``(B, 2)`` [m]; the mean is the estimated median."""
        with self._turn:
            known = self._state(state)
            if not known.encodings:
                ones = np.ones(len(actions))
                return Estimates(ones, ones, ones < 1, known.complaint, scale_m=self.scale_m)
            parts = [
                self._inference.estimate(known.encodings, actions[start : start + CHUNK])
                for start in range(0, len(actions), CHUNK)
            ]
        median = np.concatenate([part.median for part in parts])
        bound = median + self._calibrated.factor * np.concatenate([part.gap for part in parts])
        distance = np.concatenate([part.distance for part in parts])
        mean, near = np.clip(median, 0, 1), self._calibrated.familiarity.reaches(actions)
        familiar = near & (distance <= 1) & (not known.complaint)
        reason = known.complaint
        if not near.all():
            reason = reason or BEYOND.format(
                1e3 * self._calibrated.familiarity.reach_m, 1e3 * float(np.linalg.norm(actions, axis=1).max())
            )
        if not familiar.all():
            reason = reason or FAR.format(distance.max())
        return Estimates(mean, np.clip(bound, mean, 1), familiar, reason, scale_m=self.scale_m)

    def _state(self, state: State) -> _Known:
        if state.digest in self._known:
            self._known.move_to_end(state.digest)
            return self._known[state.digest]
        known = self._look_at(state)
        self._known[state.digest] = known
        while len(self._known) > STATES:
            self._known.popitem(last=False)
        return known

    def _look_at(self, state: State) -> _Known:
        complaint = self._calibrated.familiarity.complaint(state)
        if state.grid != self._calibrated.familiarity.grid:
            return _Known([], complaint)
        pooling = self._inference.pooling
        scene = inputs(state.scene.heights[None], state.scene.materials[None], pooling)
        item = inputs(state.item.heights[None], state.item.materials[None], pooling)
        return _Known(self._inference.encode(scene, item), complaint)


def read_estimator(folder: Path, *, model: str, threads: int | None = None) -> NetworkEstimator:
    """Return the MDE of a model from its weights.

    Args:
        folder: Where its weights and their card are.
        model: Name of the model.
        threads: Threads that networks compute with in this process; None leaves them as they are.

    Raises:
        ModelError: The weights are not those of this MDE, or the card lies about them, see `load_ensemble`.
    """
    if threads is not None:
        torch.set_num_threads(threads)
    return NetworkEstimator(load_ensemble(folder, model=model))


def parse_estimator(card_json: bytes, tensors: bytes, *, instead_of: NetworkEstimator) -> NetworkEstimator:
    """Return an MDE from the bytes of its card and its weights, to be served instead of another one.

    Raises:
        ModelError: As in `read_estimator`; or the weights are of another grid, or count another deviation as 1, so
            that ``d_max`` would mean something else in the middle of an optimisation.
    """
    name = f"mde_{instead_of.model}"
    card = parse_card(card_json, where=f"{name}/{CARD}", name=name)
    for what, expected, got in (
        ("grid", instead_of.grid, card.grid.grid()),
        ("deviation_scale_m", instead_of.scale_m, card.deviation_scale_m),
    ):
        if got != expected:
            raise ModelError(f"{name}: {what}: expected {expected} as of the MDE that is served, got {got}")
    return NetworkEstimator(parse_ensemble(card_json, tensors, model=instead_of.model, where=name))
