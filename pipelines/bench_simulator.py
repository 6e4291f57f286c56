"""Measure the simulator on scenes of the sampler: time, rest, penetration, resolution, sensitivity.

``python -m pipelines.bench_simulator --scenes 50`` prints one JSON object.
"""

import json
import sys
import time
from dataclasses import dataclass

import click
import numpy as np
from numpy.typing import NDArray
from rich.console import Console
from rich.progress import track

from common.domain.grid import Grid
from common.domain.scene import State
from common.tasks.plating_sampler import sample_action, sample_state
from services.simulator.model import SimulatorModel
from services.simulator.settings import LEVELS
from services.simulator.settle import settle_boxes

UNMOVED = 1e-3
"""A scene is free of path sensitivity where no fry moves by more than this [m]."""
AT_REST = 3e-3
"""Speed below which undamped dynamics counts as rest [m/s]."""


@dataclass(frozen=True)
class Settle:
    """One placement.

    Attributes:
        rigid: Whether the item is one rigid body.
        seconds: Wall time [s].
        settled: Whether it came to rest.
        creep: Largest speed in 0.2 s of undamped dynamics from there [m/s].
        depth: Deepest penetration [m].
        moved: Largest displacement of a fry [m].
        fine_rms: Difference of the heightmap to level ``fine``, RMS [m]; NaN where it was not computed.
        shifted_rms: The same to an action 0.1 mm away [m].
    """

    rigid: bool
    seconds: float
    settled: bool
    creep: float
    depth: float
    moved: float
    fine_rms: float
    shifted_rms: float


def settle_one(state: State, action: NDArray[np.float64], *, device: str, compare: bool) -> Settle:
    """Place one item and measure everything about it; ``compare`` adds a run at level ``fine`` and a shifted one."""
    from services.simulator.penetration import deepest_penetration

    placement = SimulatorModel(device=device).placement(state)
    started = time.perf_counter()
    placed = placement.run(action[None])
    seconds = time.perf_counter() - started
    first = int(placement.item is not None)
    boxes = np.array([box.position for box in placement.boxes]).reshape(-1, 3)
    moved = np.linalg.norm(placed.outcome.positions[0, first:] - boxes, axis=1).max(initial=0)
    depth = deepest_penetration(placement, placed.outcome)
    creep = placement.simulation.verify_rest()[0]
    fine_rms = shifted_rms = float("nan")
    if compare:
        fine = SimulatorModel(settings=LEVELS["fine"], device=device).placement(state).run(action[None])
        fine_rms = _rms(fine.heights, placed.heights)
        shifted_rms = _rms(placement.run(action[None] + [[1e-4, 0]]).heights, placed.heights)
    return Settle(
        state.item.is_rigid,
        seconds,
        bool(placed.settled[0]),
        float(creep),
        depth,
        float(moved),
        fine_rms,
        shifted_rms,
    )


def summary(settles: list[Settle], *, batch_rate: float, device: str) -> dict[str, object]:
    """Return the figures of a benchmark by name, SI units in the names."""
    soft = [settle.seconds for settle in settles if not settle.rigid]
    rigid = [settle.seconds for settle in settles if settle.rigid]
    calm = [settle for settle in settles if settle.moved < UNMOVED]

    def median(values: list[float], share: float = 50) -> float | None:
        known = [value for value in values if np.isfinite(value)]
        return float(np.percentile(known, share)) if known else None

    return {
        "scenes": len(settles),
        "soft_median_s": median(soft),
        "soft_p95_s": median(soft, 95),
        "rigid_median_s": median(rigid),
        "rigid_p95_s": median(rigid, 95),
        "batch_settles_per_s_per_core": batch_rate,
        "settled_share": float(np.mean([settle.settled for settle in settles])),
        "verified_share": float(np.mean([settle.creep < AT_REST for settle in settles])),
        "penetration_median_m": median([settle.depth for settle in settles]),
        "penetration_max_m": max(settle.depth for settle in settles),
        "unmoved_scenes": len(calm),
        "default_vs_fine_rms_median_m": median([settle.fine_rms for settle in calm]),
        "default_vs_fine_rms_p95_m": median([settle.fine_rms for settle in calm], 95),
        "default_vs_fine_rms_median_all_m": median([settle.fine_rms for settle in settles]),
        "shift_100um_rms_median_unmoved_m": median([settle.shifted_rms for settle in calm]),
        "shift_100um_rms_median_all_m": median([settle.shifted_rms for settle in settles]),
        "vbd_time_ratio": None,
        "device": device,
    }


@click.command()
@click.option("--scenes", default=50, show_default=True, help="Scenes of the sampler.")
@click.option("--compare", default=10, show_default=True, help="How many of them also run at level 'fine' and shifted.")
@click.option("--seed", default=0, show_default=True)
@click.option("--device", default="cpu", show_default=True, help="Warp's name of the device.")
def main(scenes: int, compare: int, seed: int, device: str) -> None:
    """Measure the simulator and print the figures as JSON."""
    SimulatorModel(device=device).warm()
    settles: list[Settle] = []
    spent, placed = 0.0, 0
    for index in track(range(scenes), "scenes", console=Console(file=sys.stderr)):
        rng = np.random.default_rng([seed, index])
        state = sample_state(rng, Grid(), settle=settle_boxes)
        settles.append(settle_one(state, sample_action(rng, state), device=device, compare=index < compare))
        if index % 5 == 0:  # meshing counts once a state, as it does for a worker
            actions = np.array([sample_action(rng, state) for _ in range(8)])
            started = time.perf_counter()
            SimulatorModel(device=device).predict(state, actions)
            spent, placed = spent + time.perf_counter() - started, placed + len(actions)
    print(json.dumps(summary(settles, batch_rate=placed / spent, device=device), indent=2))


def _rms(first: NDArray[np.float32], second: NDArray[np.float32]) -> float:
    return float(np.sqrt(np.mean((first.astype(np.float64) - second) ** 2)))


if __name__ == "__main__":
    main()
