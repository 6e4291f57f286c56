import json
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from common.domain.bodies import Plate
from common.domain.grid import Grid
from common.domain.scene import Item
from services.simulator.mesh import Mesh, build_mesh
from services.simulator.outline import outline_of
from services.simulator.samples import Samples, item_samples
from services.simulator.settings import Settings
from services.simulator.simulation import Simulation

Slab = Callable[..., Item]
REFERENCE = json.loads((Path(__file__).parents[3] / "references" / "cantilever.json").read_text())
GRID = Grid(40, 40, 0.005)


def meshed(item: Item, settings: Settings) -> tuple[Mesh, Samples]:
    outline = outline_of(item, GRID)
    mesh = build_mesh(outline, settings)
    return mesh, item_samples(outline, mesh, settings)


def test_a_clamped_beam_of_the_whole_simulator_sags_as_far_as_the_converged_solution(slab: Slab) -> None:
    settings = Settings()
    mesh, samples = meshed(slab(28, 4, youngs_modulus=4e6, grid=GRID), settings)
    clamped = mesh.positions[:, 0] < mesh.positions[:, 0].min() + 1e-9
    simulation = Simulation(
        plate=Plate(np.array([0.0, 1.0]), np.full(2, -0.5)),
        mesh=mesh,
        samples=samples,
        bodies=[],
        settings=settings,
        pinned=clamped,
    )
    simulation.place(mesh.positions[None], np.zeros((1, 0, 3)), np.zeros((1, 0, 4)))
    outcome = simulation.run()
    free = mesh.positions[:, 0] > mesh.positions[:, 0].max() - 1e-9
    sag = float((mesh.positions[free, 2] - outcome.nodes[0, free, 2]).mean())
    assert outcome.settled[0]
    assert sag == pytest.approx(REFERENCE["deflection_m"]["0.3"] / 4, rel=0.02)  # the reference has 1e6 Pa


@pytest.mark.parametrize(("degrees", "holds"), [(-1, True), (1, False)])
def test_a_soft_item_on_a_slope_holds_below_the_friction_angle_and_slides_above(
    slab: Slab, ground: Plate, degrees: float, holds: bool
) -> None:
    slope = float(np.arctan(Settings().friction) + np.radians(degrees))
    mesh, samples = meshed(slab(16, 12, youngs_modulus=3e5, grid=GRID), Settings())
    simulation = Simulation(
        plate=ground,
        mesh=mesh,
        samples=samples,
        bodies=[],
        settings=Settings(longest_time=0.6),
        gravity=(9.81 * np.sin(slope), 0.0, -9.81 * np.cos(slope)),
    )
    simulation.place(mesh.positions[None], np.zeros((1, 0, 3)), np.zeros((1, 0, 4)))
    simulation.run()
    speed = simulation.verify_rest()[0]
    assert (speed < 3e-4) if holds else (speed > 2e-2)


def test_a_mesh_weighs_what_its_item_weighs_however_it_is_turned(slab: Slab) -> None:
    x, y = np.meshgrid(GRID.x, GRID.y)
    for angle in (0.0, 0.5, 1.2):
        along, across = np.cos(angle) * x + np.sin(angle) * y, -np.sin(angle) * x + np.cos(angle) * y
        thickness = np.where((np.abs(along) < 0.06) & (np.abs(across) < 0.03), 0.02 + 0.05 * along, 0)
        materials = np.array([1000.0, 1e5, 0.3])[:, None, None] * (thickness > 0)
        mesh, _ = meshed(Item(thickness.astype(np.float32), materials.astype(np.float32)), Settings())
        assert mesh.masses.sum() == pytest.approx(1000 * thickness.sum() * GRID.cell**2, rel=0.02)
