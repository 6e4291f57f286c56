"""Another simulator of the same scene, and the race to the same answer."""

import time
from abc import ABC, abstractmethod
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

AGREE = 5e-4
"""Mean item heights agree where they differ by no more than this [m]."""

HOLD_S = 0.1
"""Simulated time for which they must agree, and be at rest: what is only passed through is no answer [s]."""

AT_REST = 3e-3
"""Speed below which the item counts as at rest [m/s]."""

LONGEST_S = 1.0
"""Simulated time after which a peer is given up [s]."""

SAMPLE_S = 0.01
"""Simulated time between two looks at a peer [s]."""


class Peer(ABC):
    """One run of another simulator.

    Attributes:
        name: The simulator and its version.
        settings: What was chosen: time step, iterations, contact.
        step_s: Its time step [s].
        warnings: What it said about its own solution so far.
    """

    name: str
    settings: dict[str, object]
    step_s: float
    warnings: Sequence[str] = ()

    @abstractmethod
    def advance(self) -> None:
        """Take one time step."""

    @abstractmethod
    def nodes(self) -> NDArray[np.float64]:
        """Return where the item's nodes are now ``(I, J, L, 3)`` [m]."""


@dataclass(frozen=True)
class Race:
    """How a peer came to the reference's answer.

    Attributes:
        name: The simulator and its version.
        settings: What was chosen.
        agrees: Whether its mean item height stayed within `AGREE` for `HOLD_S`.
        wall_s: Wall time until it had [s]; None where it never did.
        cpu_s: Processor time of the same [s].
        reached_wall_s: Wall time until that span began [s].
        rest_wall_s: Wall time until it agreed and had been at rest for `HOLD_S` [s]; None where it never was.
        end_wall_s: Wall time of the whole run [s].
        end_simulated_s: Simulated time of the whole run [s].
        mean_difference_m: Its mean item height less the reference's, at the end [m].
        rms_difference_m: RMS difference of the heights of the item's upper nodes, at the end [m].
        end_speed: Largest speed of an item's node over the last `SAMPLE_S` [m/s].
        warnings: What it said about its own solution.
    """

    name: str
    settings: dict[str, object]
    agrees: bool
    wall_s: float | None
    cpu_s: float | None
    reached_wall_s: float | None
    rest_wall_s: float | None
    end_wall_s: float
    end_simulated_s: float
    mean_difference_m: float
    rms_difference_m: float
    end_speed: float
    warnings: tuple[str, ...]


def run_race(peer: Peer, reference: NDArray[np.float64]) -> Race:
    """Advance a peer until the mean height of its upper nodes agrees with ``reference`` ``(I, J)`` [m] and rests.

    Both must last for `HOLD_S`; a peer that does not rest runs on to `LONGEST_S`. Looking at it does not count.
    """
    steps = max(round(SAMPLE_S / peer.step_s), 1)
    span = steps * peer.step_s
    wall = cpu = simulated = speed = 0.0
    entered: tuple[float, float] | None = None  # simulated and wall time
    agreed: tuple[float, float] | None = None  # wall and processor time
    rested: float | None = None
    still = 0.0
    nodes = peer.nodes()
    while simulated < LONGEST_S and rested is None and np.isfinite(nodes).all():
        started, started_cpu = time.perf_counter(), time.process_time()
        for _ in range(steps):
            peer.advance()
        wall, cpu = wall + time.perf_counter() - started, cpu + time.process_time() - started_cpu
        simulated += span
        before, nodes = nodes, peer.nodes()
        speed = float(np.linalg.norm(nodes - before, axis=-1).max() / span)
        still = still + span if speed < AT_REST else 0.0
        if abs(nodes[:, :, -1, 2].mean() - reference.mean()) > AGREE:
            entered = agreed = None
            continue
        entered = entered or (simulated, wall)
        if simulated - entered[0] >= HOLD_S - 1e-9:
            agreed = agreed or (wall, cpu)
            rested = wall if still >= HOLD_S - 1e-9 else None
    top = nodes[:, :, -1, 2]
    return Race(
        name=peer.name,
        settings=peer.settings,
        agrees=agreed is not None,
        wall_s=agreed[0] if agreed else None,
        cpu_s=agreed[1] if agreed else None,
        reached_wall_s=entered[1] if agreed and entered else None,
        rest_wall_s=rested,
        end_wall_s=wall,
        end_simulated_s=simulated,
        mean_difference_m=float(top.mean() - reference.mean()),
        rms_difference_m=float(np.sqrt(np.mean((top - reference) ** 2))),
        end_speed=speed,
        warnings=tuple(peer.warnings),
    )
