"""The ranges that a data set covers."""

from typing import Any

from numpy.typing import NDArray

from common.storage.dataset import Samples

MATERIALS = ("density", "youngs_modulus", "poisson_ratio")


def find_ranges(samples: Samples) -> dict[str, tuple[float, float]]:
    """Return the smallest and largest value of each quantity, SI units; materials only where there is something."""
    found: dict[str, tuple[float, float]] = {}
    for thing, heights, materials in (
        ("scene", samples.scene_heights, samples.scene_materials),
        ("item", samples.item_heights, samples.item_materials),
    ):
        is_there = materials[:, 0] > 0
        found[f"{thing}_height"] = _range(heights if thing == "scene" else heights[is_there])
        for channel, name in enumerate(MATERIALS):
            found[f"{thing}_{name}"] = _range(materials[:, channel][is_there])
    found["outcome_height"] = _range(samples.outcomes)
    found["action_x"], found["action_y"] = _range(samples.actions[:, 0]), _range(samples.actions[:, 1])
    return found


def _range(values: NDArray[Any]) -> tuple[float, float]:
    return (float(values.min()), float(values.max())) if values.size else (0.0, 0.0)
