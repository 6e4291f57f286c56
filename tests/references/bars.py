"""Make ``bars.json``: soft bars under their own weight, clamped, on two supports, and over an edge, by CalculiX.

Run with ``apt-get install calculix-ccx`` and ``python -m tests.references.bars`` (some minutes); the stored numbers are
what the tests compare with. Every case is also solved with half the cells in each direction.
"""

import json
import re
import subprocess
from dataclasses import asdict
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from tests.references.calculix import Bar, Deformed, bend

RADIUS = 0.005
"""Rounding of supports and edge [m]."""

CLAMPED = [Bar(0.14, 0.02, 0.01, 5.65e5, ratio) for ratio in (0.3, 0.45)]
SUPPORT = 0.05
SUPPORTED = [Bar(0.14, 0.02, 0.01, 2e5, 0.3), Bar(0.14, 0.02, 0.02, 5e4, 0.3)]
DRAPED = Bar(0.14, 0.02, 0.01, 3e5, 0.3)
EDGES = (0.06, 0.0595, 0.059, 0.0585)


def arc(centre: float, first: float, last: float) -> NDArray[np.float64]:
    """Return points of a cylinder with its crest at ``(centre, 0)``, between two angles [deg] ``(25, 2)`` [m]."""
    angles = np.radians(np.linspace(first, last, 25))
    return np.column_stack([centre + RADIUS * np.sin(angles), RADIUS * (np.cos(angles) - 1)])


def support() -> NDArray[np.float64]:
    """Return the right one of two supports."""
    return arc(SUPPORT, -60, 60)


def edge(where: float) -> NDArray[np.float64]:
    """Return a table that ends in an arc and a slope of 75 degrees ``(45, 2)`` [m]."""
    flat = np.column_stack([np.linspace(-0.002, where, 13)[:-1], np.zeros(12)])
    rounded = arc(where, 0, 75)
    way = np.linspace(0.01, 0.08, 8)[:, None]
    slope = rounded[-1] + way * np.array([np.cos(np.radians(75)), -np.sin(np.radians(75))])
    return np.concatenate([flat, rounded, slope])


def supported(bar: Bar, cells: tuple[int, int, int]) -> Deformed:
    """Return half of a bar that rests on two supports."""
    half = Bar(**(asdict(bar) | {"length": bar.length / 2}))
    return bend(half, cells, start="mirrored", profile=support())


def sag(half: Deformed) -> float:
    """Return how far the middle of the upper side is below its ends [m]."""
    return float(half.top[-1, 1] - half.top[0, 1])


def records() -> dict[str, object]:
    """Solve every case and return what is stored."""
    clamped = [
        {
            "bar": asdict(bar),
            "tip_m": bend(bar, (28, 3, 4), start="clamped").tip.tolist(),
            "half_the_cells_m": bend(bar, (14, 1, 2), start="clamped").tip.tolist(),
        }
        for bar in CLAMPED
    ]
    on_supports = []
    for bar in SUPPORTED:
        fine = supported(bar, (28, 2, 4))
        on_supports.append(
            {
                "bar": asdict(bar),
                "sag_m": sag(fine),
                "middle_m": float(fine.top[0, 1] - bar.thickness),
                "half_the_cells_m": sag(supported(bar, (14, 1, 2))),
            }
        )
    over_edge = [
        {
            "edge_m": where,
            "profile_m": np.round(edge(where), 7).tolist(),
            "tip_m": bend(DRAPED, (112, 2, 4), start="clamped", profile=edge(where)).tip.tolist(),
            "half_the_cells_m": bend(DRAPED, (56, 1, 2), start="clamped", profile=edge(where)).tip.tolist(),
        }
        for where in EDGES
    ]
    return {
        "clamped": clamped,
        "two_supports": {"profile_m": np.round(support(), 7).tolist(), "cases": on_supports},
        "over_an_edge": {"bar": asdict(DRAPED), "cases": over_edge},
    }


if __name__ == "__main__":
    shown = subprocess.run(["ccx", "-v"], capture_output=True, text=True, check=False).stdout
    version = re.search(r"Version (\S+)", shown)
    if version is None:
        raise SystemExit(f"expected a version from ccx -v, got {shown!r}")
    record = {"program": f"CalculiX {version[1]}", **records()}
    text = json.dumps(record, indent=1)
    text = re.sub(r"\[\s+(-?[\d.e-]+),\s+(-?[\d.e-]+)\s+\]", r"[\1, \2]", text)
    Path(__file__).with_suffix(".json").write_text(text + "\n")
