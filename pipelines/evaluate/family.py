"""Models and MDEs that optimise together in one process, from folders of weights."""

from collections.abc import Callable, Mapping, Sequence
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

from common.domain.errors import RequestError
from common.domain.model import PredictiveModel
from pipelines.evaluate.strategies import Kit
from pipelines.evaluate.strategies_controls import Scaling
from services.heuristic import HeuristicModel
from services.simulator.model import SimulatorModel

if TYPE_CHECKING:
    from services.mde.estimator import NetworkEstimator

LEVELS = ("simulator_coarse", "simulator", "simulator_fine")
"""Names of the simulator's levels, from cheapest to dearest."""


def find_member(name: str, weights: Mapping[str, Path]) -> PredictiveModel:
    """Return a model by name, a level of the simulator with its kernels compiled.

    Args:
        name: ``heuristic``, one of `LEVELS`, or ``learned`` and ``learned_<variant>`` with weights of that name.
        weights: Folder of the weights by the name of whose they are.

    Raises:
        RequestError: There is no such model, or no weights of it.
    """
    if name == "heuristic":
        return HeuristicModel()
    if name.partition("_")[0] == "learned" and name in weights:
        from services.learned.load import load_learned

        return load_learned(weights[name])
    if name not in LEVELS:
        known = ("heuristic", *(one for one in weights if one.startswith("learned")), *LEVELS)
        raise RequestError(f"model: expected one of {', '.join(known)}, got {name!r}")
    simulator = SimulatorModel.at_level(name.partition("_")[2] or "default")
    simulator.warm()
    return simulator


def find_estimator(name: str, weights: Mapping[str, Path]) -> "NetworkEstimator":
    """Return the MDE of a model, on one thread."""
    from services.mde.estimator import read_estimator

    return read_estimator(weights[f"mde_{name}"], model=name, threads=1)


def make_kit(
    family: Sequence[str], weights: Mapping[str, Path], *, find: Callable[[str], PredictiveModel] | None = None
) -> Kit:
    """Return models and MDEs, all in this process on one thread.

    Args:
        family: The models from cheapest to dearest, the trusted one last.
        weights: Folder of the weights by the name of whose they are; a model without ``mde_<model>`` has no MDE.
        find: Finds a model by name, by default `find_member`; it is pickled where simulators run at the same time.
    """
    find = find or partial(find_member, weights=dict(weights))
    estimated = [name for name in family[:-1] if f"mde_{name}" in weights]
    return Kit(
        {name: find(name) for name in family},
        {name: find_estimator(name, weights) for name in estimated},
        {name: read_scaling(weights[f"mde_{name}"]) for name in estimated},
        trusted=family[-1],
        make_trusted=partial(find, family[-1]),
    )


def read_scaling(folder: Path) -> Scaling:
    """Return what the card of an MDE says about its training data.

    Raises:
        RequestError: The card says neither which deviation counts as 1 nor their mean.
    """
    from common.learning.weights import read_card

    card = read_card(folder)
    mean = card.metrics.get("deviation_mean")
    if card.deviation_scale_m is None or mean is None:
        raise RequestError(
            f"{card.name}: expected deviation_scale_m and the metric deviation_mean on its card, got none"
        )
    return Scaling(card.deviation_scale_m, float(mean))


def versions(weights: Mapping[str, Path]) -> dict[str, Any]:
    """Return the simulator's version, and version and SHA-256 of weights by the name of whose they are."""
    from common.learning.weights import read_card

    cards = {name: read_card(folder) for name, folder in weights.items()}
    return {
        "simulator": SimulatorModel.version,
        "weights": {name: [card.version, card.sha256] for name, card in cards.items()},
    }
