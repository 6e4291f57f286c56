"""``frugal simulate``: one placement, with what it looks like on its way."""

import json
import time
from dataclasses import asdict
from pathlib import Path

import click
import numpy as np

from common.domain.case import Case
from common.domain.deviation import deviation
from common.domain.errors import RequestError
from services.cli.asking import find_case, say
from services.simulator.settings import LEVELS


@click.command()
@click.argument("scene")
@click.option("--action", type=float, nargs=2, metavar="X Y", help="Item's centre [m]; default: the true action.")
@click.option("--level", type=click.Choice(list(LEVELS)), default="default", show_default=True, help="Resolution.")
@click.option("--device", default="cpu", show_default=True, help="Warp's name of the device.")
@click.option("--frames", type=click.IntRange(2, 16), default=8, show_default=True, help="Frames of the strip.")
@click.option("--out", type=click.Path(path_type=Path, file_okay=False), required=True, help="Folder for the results.")
def simulate(
    *, scene: str, action: tuple[float, float] | None, level: str, device: str, frames: int, out: Path
) -> None:
    """Simulate one placement of SCENE, a case file or the name of a bundled scene.

    Writes heightmap.npz (heights (H, W) and cell in metres, action), frames.png with cross-sections and top views on
    the way to rest, and result.json.
    """
    case = find_case(scene)
    chosen = action or case.true_action
    if chosen is None:
        raise RequestError(f"expected --action X Y, as nobody knows the true action of {case.name}, got none")
    from pipelines.figures_simulation import draw_frames
    from pipelines.frames import place_with_frames
    from services.simulator.model import SimulatorModel
    from services.simulator.penetration import deepest_penetration

    model = SimulatorModel.at_level(level, device=device)
    say("loading the simulator's kernels")
    model.warm()
    where = np.array(chosen[:2])
    placement = model.placement(case.state)
    started = time.perf_counter()
    placed, seen = place_with_frames(placement, where, frames=frames)
    result = {
        "case": case.name,
        "action": where.tolist(),
        "settled": bool(placed.settled[0]),
        "speed_m_per_s": float(placed.speed[0]),
        "simulated_s": float(placed.time[0]),
        "wall_with_frames_s": time.perf_counter() - started,
        "penetration_m": deepest_penetration(placement, placed.outcome),
        "deviation_from_target_m": _from_target(case, placed.heights[0]),
        "frames_s": [frame.time for frame in seen],
        "model": model.name,
        "version": model.version,
        "device": device,
        "settings": asdict(model.settings),
    }
    out.mkdir(parents=True, exist_ok=True)
    np.savez_compressed(out / "heightmap.npz", heights=placed.heights[0], cell=case.state.grid.cell, action=where)
    title = f"{case.name}: item placed at ({where[0] * 100:+.2f}, {where[1] * 100:+.2f}) cm, {model.name}"
    draw_frames(seen, case.state.grid, title=title).savefig(out / "frames.png", dpi=110)
    (out / "result.json").write_text(json.dumps(result, indent=2) + "\n")
    state = "at rest" if result["settled"] else f"not at rest ({1e3 * float(placed.speed[0]):.1f} mm/s)"
    say(f"{state} after {placed.time[0]:.2f} s; wrote {out / 'heightmap.npz'}, {out / 'frames.png'}, result.json")


def _from_target(case: Case, heights: np.ndarray) -> float:
    """Return the mean absolute height difference to the case's target [m]."""
    return float(deviation(heights, case.target))
