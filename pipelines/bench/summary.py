"""The figures of a benchmark from its records; nothing is simulated here."""

from collections.abc import Iterable, Sequence

import numpy as np

from pipelines.bench.placements import SHIFTS, UNMOVED, PlacementRecord, Settle
from services.simulator.settings import LEVELS

AT_REST = 3e-3
"""Speed below which undamped dynamics counts as rest [m/s]."""

FORKED = 1e-4
"""A scene takes another path where 10 um of action change its heightmap by more than this, RMS [m]."""


def summarize(records: Sequence[PlacementRecord]) -> dict[str, object]:
    """Return the figures by name, SI units in the names; None where there was nothing to measure.

    ``..._rms_...`` are medians or percentiles over scenes of RMS differences between heightmaps; names with ``all``
    take every compared scene, the others those in which no fry moved by more than 1 mm.
    """
    compared = [record for record in records if record.levels]
    calm = [record for record in compared if record.calm]
    figures: dict[str, object] = {"scenes": len(records), "compared_scenes": len(compared), "calm_scenes": len(calm)}
    for kind, chosen in (("soft", False), ("rigid", True)):
        runs = [record for record in records if record.rigid == chosen]
        figures[f"{kind}_median_s"] = percentile((run.wall_s for run in runs), 50)
        figures[f"{kind}_p95_s"] = percentile((run.wall_s for run in runs), 95)
        figures[f"{kind}_median_cpu_s"] = percentile((run.cpu_s for run in runs), 50)
        figures[f"{kind}_p95_cpu_s"] = percentile((run.cpu_s for run in runs), 95)
    figures |= {
        "prepare_median_s": percentile((record.prepare_s for record in records), 50),
        "settled_share": share(record.settled for record in records),
        "verified_share": share(record.settled and record.creep < AT_REST for record in records),
        "penetration_median_m": percentile((record.depth for record in records), 50),
        "penetration_max_m": percentile((record.depth for record in records), 100),
    }
    for name, chosen in (("", calm), ("_all", compared)):
        differences = [record.levels["default"].rms for record in chosen]
        figures[f"default_vs_fine_rms_median{name}_m"] = percentile(differences, 50)
        figures[f"default_vs_fine_rms_p95{name}_m"] = percentile(differences, 95)
    figures |= _sensitivity(compared)
    figures["levels"] = {name: _level(name, compared, calm) for name in LEVELS}
    return figures


def percentile(values: Iterable[float], at: float) -> float | None:
    """Return a percentile, None of nothing."""
    known = list(values)
    return float(np.percentile(known, at)) if known else None


def share(facts: Iterable[bool]) -> float | None:
    """Return the share of what is true, None of nothing."""
    known = list(facts)
    return float(np.mean(known)) if known else None


def _sensitivity(compared: Sequence[PlacementRecord]) -> dict[str, object]:
    figures: dict[str, object] = {}
    for name in SHIFTS:
        every = [record.shifts[name].rms for record in compared]
        still = [
            record.shifts[name].rms for record in compared if max(record.moved, record.shifts[name].moved) <= UNMOVED
        ]
        figures[f"shift_{name}_rms_median_m"] = percentile(still, 50)
        figures[f"shift_{name}_rms_p95_m"] = percentile(still, 95)
        figures[f"shift_{name}_rms_median_all_m"] = percentile(every, 50)
        figures[f"shift_{name}_rms_p95_all_m"] = percentile(every, 95)
    path = np.array([record.shifts["10um"].rms for record in compared])
    resolution = np.array([record.levels["default"].rms for record in compared])
    figures["forked_share"] = share(path > FORKED)
    known = (resolution**2).sum() > 0
    figures["path_sensitivity_share"] = min(1.0, float((path**2).sum() / (resolution**2).sum())) if known else None
    return figures


def _level(name: str, compared: Sequence[PlacementRecord], calm: Sequence[PlacementRecord]) -> dict[str, object]:
    runs: list[tuple[bool, Settle]] = [(record.rigid, record.levels[name]) for record in compared]
    differences = [record.levels[name].rms for record in calm]
    every = [run.rms for _, run in runs]
    return {
        "soft_median_s": percentile((run.wall_s for rigid, run in runs if not rigid), 50),
        "soft_p95_s": percentile((run.wall_s for rigid, run in runs if not rigid), 95),
        "rigid_median_s": percentile((run.wall_s for rigid, run in runs if rigid), 50),
        "rigid_p95_s": percentile((run.wall_s for rigid, run in runs if rigid), 95),
        "median_cpu_s": percentile((run.cpu_s for _, run in runs), 50),
        "settled_share": share(run.settled for _, run in runs),
        "vs_fine_rms_median_m": percentile(differences, 50),
        "vs_fine_rms_p95_m": percentile(differences, 95),
        "vs_fine_rms_median_all_m": percentile(every, 50),
        "vs_fine_rms_p95_all_m": percentile(every, 95),
    }
