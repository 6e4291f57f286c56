"""What a placement looks like on its way to rest."""

from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from pipelines.sections import Section, cut
from services.simulator.placement import Placed, Placement


@dataclass(frozen=True)
class Frame:
    """One moment of a placement.

    Attributes:
        time: Simulated time [s].
        heights: Heightmap ``(H, W)`` [m].
        section: Cross-section along the item's longer axis.
    """

    time: float
    heights: NDArray[np.float32]
    section: Section


def place_with_frames(
    placement: Placement, action: NDArray[np.float64], *, frames: int = 8
) -> tuple[Placed, list[Frame]]:
    """Place the item at ``action`` ``(2,)`` [m] and return the outcome and frames of the way, the last one at rest.

    The simulator stops for a look every few evaluations of the forces; frames are chosen so that the item moves about
    as far from each to the next.
    """
    seen: list[Frame] = []

    def look() -> None:
        now = placement.simulation.read()
        if not seen or float(now.time[0]) > seen[-1].time:
            seen.append(Frame(float(now.time[0]), placement.heights_now()[0], cut(placement, now, action)))

    placed = placement.run(action[None], check=look)
    last = Frame(float(placed.time[0]), placed.heights[0], cut(placement, placed.outcome, action))
    seen = [frame for frame in seen if frame.time < last.time]
    return placed, [*_evenly([*seen, last], frames - 1), last]


def _evenly(frames: list[Frame], count: int) -> list[Frame]:
    """Return ``count`` frames before the last one, or all there are, at even distances along the item's way."""
    moves = [float(np.abs(after.section.item - before.section.item).mean()) for before, after in pairwise(frames)]
    way = np.concatenate([[0.0], np.cumsum(moves)])
    wanted = np.linspace(0, way[-1], count + 1)[:-1]
    chosen = sorted({int(np.abs(way[:-1] - place).argmin()) for place in wanted}) if len(frames) > 1 else []
    return [frames[index] for index in chosen]
