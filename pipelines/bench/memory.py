"""Memory of a worker after many placements of many states, measured in a process of its own."""

import json
import subprocess
import sys
from pathlib import Path

import numpy as np

from pipelines.bench.placements import draw_scene
from services.simulator.model import SimulatorModel

PER_STATE = 10
"""Placements of one state before the next state comes."""

STATM = Path("/proc/self/statm")
PAGE = 4096


def measure_memory(placements: int, *, seed: int, level: str, device: str) -> dict[str, float | int]:
    """Return the memory [B] after a tenth of the placements and after all, and their ratio.

    A child process does the work, so that nothing but a worker's model is counted.
    """
    arguments = [str(placements), str(seed), level, device]
    done = subprocess.run(
        [sys.executable, "-m", "pipelines.bench.memory", *arguments], stdout=subprocess.PIPE, text=True, check=True
    )
    return json.loads(done.stdout.splitlines()[-1])


def _place_many(placements: int, *, seed: int, level: str, device: str) -> dict[str, float | int]:
    model = SimulatorModel.at_level(level, device=device)
    early, done = 0, 0
    after_early = 0
    while done < placements:
        state, _, rng = draw_scene(seed, done // PER_STATE)
        for _ in range(min(PER_STATE, placements - done)):
            model.predict(state, rng.uniform(-0.05, 0.05, (1, 2)))
            done += 1
            if done == max(placements // 10, 1):
                early, after_early = done, _resident()
    after_all = _resident()
    return {
        "placements_early": early,
        "placements": done,
        "resident_early_bytes": after_early,
        "resident_bytes": after_all,
        "ratio": float(np.round(after_all / after_early, 4)),
    }


def _resident() -> int:
    """Return the resident memory of this process [B]; only Linux tells."""
    return int(STATM.read_text().split()[1]) * PAGE


if __name__ == "__main__":
    count, seed_text, level_name, device_name = sys.argv[1:]
    print(json.dumps(_place_many(int(count), seed=int(seed_text), level=level_name, device=device_name)))
