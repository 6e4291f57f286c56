"""Trials and the result of an optimisation: the answer and its evidence."""

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from common.domain.certificate import Certificate
from common.domain.model import Event


@dataclass(frozen=True)
class Trial:
    """One evaluated action.

    Attributes:
        index: Order of asking, from 0.
        action: The action's parameters [m].
        model: Name of the model that predicted its outcome.
        instance: The worker that answered.
        version: The model's version.
        reward: Reward of the prediction [m]; None if no model could predict it.
        estimates: Estimated deviation by model, for all models that were considered.
        warning: What the model said about this outcome, empty if nothing.
        started_s: When the trial was dispatched, since the optimisation began [s].
        predict_s: From dispatch to answer [s].
        compute_s: The part of it that the model took [s].
        error: Why there is no reward, empty if there is one.
        uppers: Upper bound of the estimated deviation by model.
        unfamiliar: Models whose MDE does not know such inputs.
        mdes: Version of the MDE that estimated, by model.
    """

    index: int
    action: tuple[float, ...]
    model: str
    instance: str
    version: str
    reward: float | None
    estimates: dict[str, float] = field(default_factory=dict[str, float])
    warning: str = ""
    started_s: float = 0.0
    predict_s: float = 0.0
    compute_s: float = 0.0
    error: str = ""
    uppers: dict[str, float] = field(default_factory=dict[str, float])
    unfamiliar: tuple[str, ...] = ()
    mdes: dict[str, str] = field(default_factory=dict[str, str])


@dataclass(frozen=True)
class Result:
    """The answer of one optimisation.

    Attributes:
        action: The best action [m].
        reward: Its predicted reward [m].
        heights: Its predicted heightmap ``(H, W)`` [m].
        trials: Every evaluated action, in the order of asking.
        usage: Number of evaluated actions by model: trials, and what strategies asked cheap models in sweeps.
        models: Version by model that was used, and by ``mde/<model>``; several are joined by commas.
        split_s: Time by model, and for ``mde``, ``optimiser`` and ``transport``, calls at the same time added up;
            ``transport`` includes waiting for a free worker [s].
        wall_s: Duration of the whole optimisation [s].
        events: What went wrong and was dealt with.
        strategy: Name of the selection strategy.
        seed: Seed of every random choice.
        in_flight: Largest number of evaluations at the same time, on which the trials depend as on the seed.
        certificate: How much better another action may be; None where the strategy cannot say.
    """

    action: tuple[float, ...]
    reward: float
    heights: NDArray[np.float32]
    trials: tuple[Trial, ...]
    usage: dict[str, int]
    models: dict[str, str]
    split_s: dict[str, float]
    wall_s: float
    events: tuple[Event, ...]
    strategy: str
    seed: int
    in_flight: int = 1
    certificate: Certificate | None = None
