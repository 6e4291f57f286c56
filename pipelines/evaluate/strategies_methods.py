"""What is compared: strategies with options, and the sets of them."""

import re
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import partial

from common.domain.errors import RequestError
from common.planning.optimize import MOST_IN_FLIGHT
from common.planning.selection import MOST_CALLS, parse_strategy
from common.planning.strategy import Strategy
from common.planning.strategy_only import OnlyStrategy
from common.planning.strategy_planner import PlannerStrategy
from pipelines.evaluate.strategies_controls import CONTROLS, TRUSTING
from pipelines.evaluate.strategies_polish import PolishStrategy
from pipelines.evaluate.threshold import Method

OPTIONS = f"{', '.join(CONTROLS)}, {TRUSTING}, d_max=<number>, <number>-in-flight"
FOREIGN = ("botorch:ucb", "botorch:logei", "botorch:mfkg:calls=<number>", "polish:calls=<number>")
"""Strategies that are there to be compared with, besides those of `parse_strategy`."""


@dataclass(frozen=True)
class Contender(Method):
    """One way to optimise, ``<strategy>[+<option>...]``.

    Attributes:
        name: As it was asked for.
        control: What replaces the MDEs; empty if nothing does.
        in_flight: Evaluations, and trusted models, at the same time.
        trusting: Whether the MDEs' estimates are used on inputs that they do not know, too.
    """

    name: str = ""
    control: str = ""
    in_flight: int = 1
    trusting: bool = False

    @property
    def label(self) -> str:
        """Return a name that no other one has."""
        return self.name


def parse_contender(text: str, *, trusted: str, in_flight: int = 1) -> Contender:
    """Return what ``text`` names, for instance ``threshold+d_max=0.2`` or ``quality+oracle-mde``.

    Args:
        text: A strategy with options.
        trusted: The trusted model, which the reference asks alone.
        in_flight: Evaluations at the same time where no option says so.

    Raises:
        RequestError: There is no such strategy or option.
    """
    strategy, *options = text.split("+")
    control, d_max, trusting = "", 0.4, False
    for option in options:
        flying = re.fullmatch(r"(\d{1,3})-in-flight", option)
        threshold = re.fullmatch(r"d_max=(0?\.\d+|1|1\.0)", option)
        if option in CONTROLS:
            control = option
        elif option == TRUSTING:
            trusting = True
        elif flying and 1 <= int(flying[1]) <= MOST_IN_FLIGHT:
            in_flight = int(flying[1])
        elif threshold and float(threshold[1]) > 0:
            d_max = float(threshold[1])
        else:
            raise RequestError(f"{text}: expected one of {OPTIONS} after +, got {option!r}")
    if in_flight > 1 and (strategy.startswith("botorch:") or control == "oracle-mde"):
        raise RequestError(f"{text}: expected one evaluation in flight, got {in_flight}")
    make_strategy(strategy, trusted=trusted)
    return Contender(strategy, d_max, name=text, control=control, in_flight=in_flight, trusting=trusting)


def make_strategy(text: str, *, trusted: str, costs: Mapping[str, float] | None = None) -> Strategy:
    """Return a strategy by name: one of `parse_strategy`, or one of `FOREIGN`.

    Args:
        text: The name.
        trusted: The trusted model.
        costs: What a call of each model takes, by name [s].

    Raises:
        RequestError: There is none of this name, or what it needs is not installed.
    """
    family, _, option = text.partition(":")
    if family not in ("botorch", "polish"):
        return parse_strategy(text)
    if text in ("botorch:ucb", "botorch:logei"):
        from pipelines.optimizers.botorch_planner import BotorchPlanner, import_botorch

        import_botorch()
        make = partial(BotorchPlanner, acquisition="ucb" if option == "ucb" else "logei")
        return PlannerStrategy(OnlyStrategy(trusted), make, name=text)
    found = re.fullmatch(r"(botorch:mfkg|polish):calls=(\d{1,4})", text)
    if not found or not 1 <= int(found[2]) <= MOST_CALLS:
        raise RequestError(f"strategy: expected one of {', '.join(FOREIGN)}, got {text[:80]!r}")
    if found[1] == "polish":
        return PolishStrategy(int(found[2]))
    from pipelines.optimizers.botorch_fidelities import FidelityStrategy

    return FidelityStrategy(int(found[2]), costs or {})


def reference(trusted: str) -> str:
    """Return the name of what everything is compared with: the trusted model alone."""
    return f"only:{trusted}"


PRESETS = ("fast", "balanced", "quality")
RESIDUALS = ("residual:calls=2", "residual:calls=4", "residual:calls=12")
POLISHES = ("polish:calls=2", "polish:calls=4", "polish:calls=12")
SETS: dict[str, Callable[[str], tuple[str, ...]]] = {
    "main": lambda trusted: (
        reference(trusted), *PRESETS, *RESIDUALS, *POLISHES, "threshold", "threshold:upper", "only:heuristic",
    ),
    "mdes": lambda trusted: tuple(
        f"{name}{option}"
        for name in (*PRESETS, *RESIDUALS, "threshold")
        for option in ("", *(f"+{control}" for control in CONTROLS))
    ),
    "d_max": lambda trusted: ("threshold", *(f"threshold+d_max={d_max}" for d_max in (0.1, 0.2, 0.3, 0.6, 0.8))),
    "calls": lambda trusted: tuple(
        f"{family}:calls={calls}" for family in ("transport", "residual", "polish") for calls in (3, 6, 8, 18, 25)
    ),
    "botorch": lambda trusted: ("botorch:ucb", "botorch:logei"),
    "fidelities": lambda trusted: ("botorch:mfkg:calls=6",),
    "in-flight": lambda trusted: ("quality", f"{reference(trusted)}+2-in-flight", "quality+2-in-flight"),
}  # fmt: skip
"""Name -> what is compared, given the trusted model: by default ``main``; ``mdes`` swaps the MDEs, ``d_max`` and
``calls`` are sweeps, ``fidelities`` is BoTorch's multi-fidelity loop, which takes minutes a target."""
