"""The simulator's benchmark: placements, batches, memory, peers, and what they were measured with."""

import importlib.metadata
import os
import platform
from collections.abc import Callable
from dataclasses import asdict, dataclass

import numpy as np

from common.tasks.plating_sampler import sample_action
from pipelines.bench.memory import measure_memory
from pipelines.bench.placements import PlacementRecord, batch_time, draw_scene, measure_placement
from pipelines.bench.summary import summarize
from services.simulator.model import SimulatorModel
from services.simulator.settings import LEVELS

BATCH = 8
"""Actions of one batch."""

BATCH_EVERY = 5
"""One scene in so many is also asked for a batch."""


@dataclass(frozen=True)
class BenchOptions:
    """What to measure.

    Attributes:
        scenes: Scenes of the sampler.
        compare: How many of the first scenes also run at the other levels and moved; of the later ones only those in
            which no fry moves, until there are as many of them.
        seed: Seed of scenes and actions.
        level: The level measured, one of `LEVELS`.
        device: Warp's name of the device.
        peers: Whether to run the other simulators that are installed.
        memory: Placements after which memory is compared with that after a tenth of them; 0 leaves it out.
    """

    scenes: int = 50
    compare: int = 10
    seed: int = 0
    level: str = "default"
    device: str = "cpu"
    peers: bool = True
    memory: int = 0


@dataclass(frozen=True)
class BenchResult:
    """The figures by name, and the records that they rest on."""

    figures: dict[str, object]
    records: tuple[PlacementRecord, ...]


def bench_simulator(options: BenchOptions, *, report: Callable[[str], None] = lambda _: None) -> BenchResult:
    """Measure the simulator; ``report`` is called with what was done after every scene and before every long stage."""
    SimulatorModel.at_level(options.level, device=options.device).warm()
    records: list[PlacementRecord] = []
    wall = cpu = 0.0
    placed = calm = 0
    for index in range(options.scenes):
        state, action, rng = draw_scene(options.seed, index)
        record = measure_placement(
            state,
            action,
            index=index,
            level=options.level,
            device=options.device,
            compare=index < options.compare,
            compare_calm=calm < options.compare,
        )
        calm += bool(record.levels) and record.calm
        records.append(record)
        if index % BATCH_EVERY == 0:
            actions = np.array([sample_action(rng, state) for _ in range(BATCH)])
            took = batch_time([(state, actions)], level=options.level, device=options.device)
            wall, cpu, placed = wall + took[0], cpu + took[1], placed + BATCH
        report("scenes")
    figures = summarize(records)
    figures["batch_settles_per_s_per_core"] = placed / wall
    figures["batch_settles_per_cpu_s"] = placed / cpu
    figures["memory"] = None
    if options.memory:
        report("memory")
        figures["memory"] = measure_memory(
            options.memory, seed=options.seed, level=options.level, device=options.device
        )
    figures |= dict.fromkeys(("vbd_time_ratio", "flex_time_ratio", "peers"))
    if options.peers:
        from pipelines.bench.peers import compare_peers

        report("peers")
        figures |= compare_peers()
    return BenchResult(figures | conditions(options), tuple(records))


def conditions(options: BenchOptions) -> dict[str, object]:
    """Return what a result was measured with: options, settings, versions, machine."""
    return {
        "device": options.device,
        "seed": options.seed,
        "level": options.level,
        "version": SimulatorModel.version,
        "options": asdict(options),
        "settings": {name: asdict(settings) for name, settings in LEVELS.items()},
        "packages": {name: importlib.metadata.version(name) for name in ("frugal", "numpy", "warp-lang")},
        "machine": {"processor": _processor(), "cores": os.cpu_count(), "load": _load()},
    }


def _processor() -> str:
    try:
        with open("/proc/cpuinfo") as lines:
            return next(line.partition(":")[2].strip() for line in lines if line.startswith("model name"))
    except (OSError, StopIteration):
        return platform.processor() or platform.machine()


def _load() -> float | None:
    """Return how many processes wanted to run in the last minute; with more than the cores, wall times are too long."""
    return os.getloadavg()[0] if hasattr(os, "getloadavg") else None
