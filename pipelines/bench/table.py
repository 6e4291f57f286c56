"""The benchmark's figures as a table for a person."""

from typing import Any

from rich import box
from rich.table import Table

ROWS: tuple[tuple[str, tuple[tuple[str, float, str], ...]], ...] = (
    ("soft item: median, p95", (("soft_median_s", 1, "s"), ("soft_p95_s", 1, "s"))),
    ("rigid item: median, p95", (("rigid_median_s", 1, "s"), ("rigid_p95_s", 1, "s"))),
    ("processor time: soft, rigid median", (("soft_median_cpu_s", 1, "s"), ("rigid_median_cpu_s", 1, "s"))),
    ("a state, made ready", (("prepare_median_s", 1, "s"),)),
    ("batches a second and core, wall", (("batch_settles_per_s_per_core", 1, ""),)),
    ("batches a second of processor time", (("batch_settles_per_cpu_s", 1, ""),)),
    ("at rest, verified", (("settled_share", 100, "%"), ("verified_share", 100, "%"))),
    ("penetration: median, largest", (("penetration_median_m", 1e3, "mm"), ("penetration_max_m", 1e3, "mm"))),
    (
        "default against fine, calm: median, p95",
        (("default_vs_fine_rms_median_m", 1e3, "mm"), ("default_vs_fine_rms_p95_m", 1e3, "mm")),
    ),
    (
        "default against fine, all: median, p95",
        (("default_vs_fine_rms_median_all_m", 1e3, "mm"), ("default_vs_fine_rms_p95_all_m", 1e3, "mm")),
    ),
    ("of that, path sensitivity", (("path_sensitivity_share", 100, "%"),)),
    (
        "0.1 mm of action: calm, all",
        (("shift_100um_rms_median_m", 1e3, "mm"), ("shift_100um_rms_median_all_m", 1e3, "mm")),
    ),
    (
        "1 mm of action: calm, all",
        (("shift_1mm_rms_median_m", 1e3, "mm"), ("shift_1mm_rms_median_all_m", 1e3, "mm")),
    ),
    ("Newton VBD, MuJoCo flex to rest or 1 s: times as long", (("vbd_time_ratio", 1, ""), ("flex_time_ratio", 1, ""))),
)
"""What a row is called -> key, factor and unit of its figures."""

LEVEL_COLUMNS: tuple[tuple[str, str, float], ...] = (
    ("soft, s", "soft_median_s", 1),
    ("p95", "soft_p95_s", 1),
    ("rigid, s", "rigid_median_s", 1),
    ("p95", "rigid_p95_s", 1),
    ("to fine, calm, mm", "vs_fine_rms_median_m", 1e3),
    ("p95", "vs_fine_rms_p95_m", 1e3),
    ("all", "vs_fine_rms_median_all_m", 1e3),
)
"""Heading -> key and factor of a level's figures: medians, and their 95th percentiles beside them."""


def figures_table(figures: dict[str, Any]) -> Table:
    """Return one row a figure."""
    title = (
        f"{figures['scenes']} scenes, {figures['compared_scenes']} compared, {figures['calm_scenes']} of these calm; "
        f"level {figures['level']}, {figures['device']}, seed {figures['seed']}, version {figures['version']}"
    )
    table = Table("what", "figure", box=box.SIMPLE_HEAD, pad_edge=False, title=title, title_justify="left")
    for name, cells in ROWS:
        table.add_row(name, ", ".join(_text(figures.get(key), factor, unit) for key, factor, unit in cells))
    memory = figures["memory"]
    if memory:
        early, late = memory["placements_early"], memory["placements"]
        table.add_row(f"memory after {late} placements over that after {early}", f"{memory['ratio']:.3f}")
    return table


def levels_table(figures: dict[str, Any]) -> Table:
    """Return one row a level: time, and error against ``fine``."""
    names = [column[0] for column in LEVEL_COLUMNS]
    table = Table("level", *names, box=box.SIMPLE_HEAD, pad_edge=False)
    for level, values in figures["levels"].items():
        table.add_row(level, *(_text(values[key], factor) for _, key, factor in LEVEL_COLUMNS))
    return table


def _text(value: float | None, factor: float, unit: str = "") -> str:
    return "-" if value is None else f"{value * factor:.3g} {unit}".strip()
