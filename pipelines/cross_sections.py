"""Draw how the same item lies on the same fries at several stiffnesses: ``python -m pipelines.cross_sections``."""

from pathlib import Path

import click
import numpy as np
from rich.console import Console
from rich.progress import track

from common.domain.bodies import Bodies, Box, Material
from common.domain.grid import Grid
from common.domain.scene import Item, State
from common.tasks.plating import dinner_plate, render_scene
from pipelines.sections import Section, cut
from services.simulator.model import SimulatorModel
from services.simulator.settle import settle_boxes

MODULI = (5e3, 2e4, 5e4, 2e5, 1e6, 1e9)
"""Young's moduli of the figure [Pa]; the last one is rigid."""

FRIES = ((-0.030, 0.0, 0.006, 1.5), (-0.018, 0.0, 0.006, 1.6), (-0.024, 0.0, 0.018, 1.4), (0.045, 0.0, 0.006, 1.3))
"""Centre [m] and yaw [rad] before they settle: two side by side with one on top, and one by itself."""

ACTION = np.array([0.015, 0.0])


def sections_over_stiffness(*, level: str = "default") -> list[tuple[str, Section]]:
    """Place a steak of 14 x 9 x 2 cm at every modulus of `MODULI` and cut it along its length."""
    plate, grid = dinner_plate(), Grid()
    boxes = settle_boxes(plate, [_fry(*place) for place in FRIES])
    scene = render_scene(grid, Bodies(plate, boxes))
    covered = (np.abs(grid.x[None, :]) < 0.0705) & (np.abs(grid.y[:, None]) < 0.045)
    model = SimulatorModel.at_level(level)
    found = []
    for modulus in track(MODULI, "placements", console=Console(stderr=True)):
        material = np.array([1050.0, modulus, 0.3])[:, None, None]
        item = Item((covered * 0.02).astype(np.float32), (covered * material).astype(np.float32))
        state = State(scene, item)
        placement = model.placement(state)
        placed = placement.run(ACTION[None])
        name = "rigid" if item.is_rigid else f"E = {modulus:.0e} Pa".replace("e+0", "e")
        found.append((name, cut(placement, placed.outcome, ACTION, top=0.05)))
    return found


def _fry(x: float, y: float, z: float, yaw: float) -> Box:
    turn = np.array([0.0, 0.0, np.sin(yaw / 2), np.cos(yaw / 2)])
    return Box(np.array([0.06, 0.01, 0.01]), np.array([x, y, z]), turn, Material(550.0, 1e6, 0.3))


@click.command()
@click.option("--out", type=click.Path(path_type=Path), default=Path("docs/cross_sections.png"), show_default=True)
@click.option("--level", default="default", show_default=True)
def main(out: Path, level: str) -> None:
    """Draw deformed cross-sections over stiffness."""
    from pipelines.figures_simulation import draw_sections

    figure = draw_sections(
        sections_over_stiffness(level=level), title="One steak (14 x 9 x 2 cm, nu = 0.3) on the same fries, at rest"
    )
    figure.savefig(out, dpi=80)


if __name__ == "__main__":
    main()
