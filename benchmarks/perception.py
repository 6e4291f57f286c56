"""Measure how well plate and fries are found in scenes of which only heightmap and masks are known.

Run ``python -m benchmarks.perception --count 50``.
"""

import argparse
import dataclasses
import json
import time

import numpy as np

from common.domain.bodies import Bodies
from common.domain.deviation import deviation
from common.domain.errors import ModelError
from common.domain.grid import Grid
from common.tasks.plating import render_scene
from common.tasks.plating_sampler import LAYOUTS, sample_scene
from services.simulator.perception import find_bodies
from services.simulator.settle import settle_boxes


def main() -> None:
    """Print one JSON object: heightmap differences [mm] as found and as settled again, fries, time [s]."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--count", type=int, default=50)
    parser.add_argument("--seed", type=int, default=1000)
    arguments = parser.parse_args()
    grid = Grid()
    found_mm, fry_rms_mm, settled_mm, moved_mm, fries, seconds, restless = [], [], [], [], [], [], 0
    for index in range(arguments.count):
        rng = np.random.default_rng(arguments.seed + index)
        scene = sample_scene(rng, grid, settle=settle_boxes, layout=LAYOUTS[index % len(LAYOUTS)])
        start = time.process_time()
        bodies = find_bodies(dataclasses.replace(scene, bodies=None))
        seconds.append(time.process_time() - start)
        heights = render_scene(grid, bodies).heights
        found_mm.append(1e3 * deviation(heights, scene.heights))
        fry_cells = scene.materials[0] > 0
        fry_rms_mm.append(1e3 * np.sqrt(((heights - scene.heights)[fry_cells] ** 2).mean()))
        fries.append((len(scene.bodies.boxes) if scene.bodies else 0, len(bodies.boxes)))
        try:
            assert bodies.plate is not None
            settled = settle_boxes(bodies.plate, bodies.boxes)
        except ModelError:
            restless += 1
            continue
        settled_mm.append(1e3 * deviation(render_scene(grid, Bodies(bodies.plate, settled)).heights, scene.heights))
        moves = [np.hypot(*(a.position - b.position)[:2]) for a, b in zip(settled, bodies.boxes, strict=True)]
        moved_mm.append(1e3 * max(moves))
    true, found = np.array(fries).T
    print(
        json.dumps(
            {
                "scenes": arguments.count,
                "found_mean_abs_mm": _summary(found_mm),
                "found_rms_over_fries_mm": _summary(fry_rms_mm),
                "settled_mean_abs_mm": _summary(settled_mm),
                "settled_largest_move_mm": _summary(moved_mm),
                "not_settled": restless,
                "fries_true": int(true.sum()),
                "fries_found": int(found.sum()),
                "scenes_with_the_right_number": float((true == found).mean()),
                "scenes_with_too_many": float((found > true).mean()),
                "cpu_s": _summary(seconds),
            },
            indent=1,
        )
    )


def _summary(values: list[float]) -> dict[str, float]:
    mean, median, worst = np.mean(values), np.median(values), np.max(values)
    return {"mean": round(float(mean), 4), "median": round(float(median), 4), "max": round(float(worst), 4)}


if __name__ == "__main__":
    main()
