"""Which action a robot should try next, so that its trials teach an MDE the most."""

import math
from collections.abc import Callable, Sequence
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from common.domain.errors import RequestError
from common.domain.scene import State
from common.learning.training import threads
from pipelines.mde.active_belief import Belief, Points, believe
from pipelines.mde.descriptions import describe_actions
from pipelines.mde.finetune import sim_to_sim
from services.mde.ensemble import Calibrated

Pairs = Sequence[tuple[State, NDArray[np.float64]]]
"""States, each with actions ``(B, 2)`` [m]."""

Acquisition = Callable[[Belief, np.random.Generator], NDArray[np.float64]]
"""``acquisition(belief, rng)``: a score of every candidate ``(C,)``; the largest is tried next."""

AcquisitionName = Literal["random", "lcb", "variance", "integrated"]

BETA = 2.0
"""Standard deviations below the mean in `lcb`."""


def lcb(belief: Belief, rng: np.random.Generator) -> NDArray[np.float64]:
    """Prefer where the model may well be applicable: minus ``mean - BETA sigma`` (LaGrassa, Lee, Kroemer 2024)."""
    chosen = slice(belief.candidates)
    return BETA * np.sqrt(belief.variance[chosen]) - belief.mean[chosen]


ACQUISITIONS: dict[AcquisitionName, Acquisition] = {
    "random": lambda belief, rng: rng.random(belief.candidates),
    "lcb": lcb,
    "variance": lambda belief, rng: belief.variance[: belief.candidates],
    "integrated": lambda belief, rng: belief.reductions(),
}
"""Name -> acquisition. ``variance`` goes where least is known, ``integrated`` where a trial tells most about what the
robot will meet."""


def choose_next(belief: Belief, acquisition: AcquisitionName, *, count: int = 1, seed: int = 0) -> list[int]:
    """Return the candidates to try next, in this order, no two the same.

    Each is chosen as if those before it had shown what was expected.

    Args:
        belief: What is known.
        acquisition: Name of the acquisition.
        count: How many to choose, 1 to the number of candidates.
        seed: Seed of random choices.

    Raises:
        RequestError: There are not so many candidates.
    """
    if not 1 <= count <= belief.candidates:
        raise RequestError(f"count: expected 1 to {belief.candidates}, the number of candidates, got {count}")
    rng, chosen = np.random.default_rng(seed), list[int]()
    for _ in range(count):
        scores = ACQUISITIONS[acquisition](belief, rng)
        scores[chosen] = -math.inf
        chosen.append(int(scores.argmax()))
        belief = belief.tried(chosen[-1])
    return chosen


def belief_of(
    base: Calibrated,
    model: str,
    *,
    trials: Pairs,
    deviations: NDArray[np.floating],
    candidates: Pairs,
    reference: Pairs = (),
) -> Belief:
    """Return what an MDE and trials say about candidates, and about what the robot will meet.

    Args:
        base: The MDE, sim-to-sim or fine-tuned.
        model: The model whose deviation it is.
        trials: The trials so far, none or more.
        deviations: The model's deviations there ``(N,)``, scaled to [0, 1].
        candidates: What may be tried next.
        reference: What the robot will meet; the candidates if empty.
    """
    with threads(1):
        known, points = (points_of(base, model, pairs) for pairs in (trials, [*candidates, *reference]))
    count = sum(len(actions) for _, actions in candidates)
    return believe(known, np.asarray(deviations, dtype=np.float64), points, candidates=count)


def points_of(base: Calibrated, model: str, pairs: Pairs) -> Points:
    """Return states with actions as the networks of an MDE see them, actions in the order of their states."""
    ensemble = base.ensemble
    members, features = ensemble.means.shape
    described, estimates = [np.empty((0, members * features))], [np.empty(0)]
    for state, actions in pairs:
        found = describe_actions(ensemble, state, actions) - ensemble.means[:, None]
        white = (found @ ensemble.whitenings.transpose(1, 2)).transpose(0, 1).flatten(1)
        described.append(white.double().numpy() / math.sqrt(members * features))
        estimates.append(sim_to_sim(base, model, state, actions)[0])
    return Points(np.concatenate(described), np.concatenate(estimates))
