from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation
from soft_scenes import ABYSS, FLOOR, GRAVITY, Alone, alone, bar

from common.domain.bodies import ROUNDING, Box
from services.simulator.bodies import Body, box_body
from services.simulator.samples import TOP
from services.simulator.settings import Settings
from services.simulator.simulation import Simulation
from services.simulator.stiffness import centre_gradients, hexahedron_stiffness

PATH = replace(
    Settings(),
    first_step=0.002,
    longest_step=0.002,
    shortest_step=0.002,
    iterations=20,
    tolerance=1e-7,
    relative_tolerance=1e-4,
    longest_time=0.4,
)


def energies_of(simulation: Simulation, energy: Callable[[], float]) -> NDArray[np.float64]:
    """Run a simulation and return its energy now and then [J]."""
    seen = [energy()]
    simulation.run(check=lambda: seen.append(energy()))
    return np.array([*seen, energy()])


def largest_rise(energies: NDArray[np.float64]) -> float:
    """Return by how much the energy was ever above its lowest value before, as a share of all that was lost."""
    assert len(energies) > 20
    lowest = np.minimum.accumulate(energies)[:-1]
    return float((energies[1:] - lowest).max() / (energies[0] - energies[-1]))


def pressed(stiffness: NDArray[np.float64], depth: NDArray[np.float64], softening: float) -> float:
    """Return the energy in contacts: the force k g^2 / 2 s, from the depth s on k (g - s / 2), integrated [J]."""
    depth = np.maximum(depth, 0)
    beyond = softening**2 / 6 + depth * (depth - softening) / 2
    return float((stiffness * np.where(depth < softening, depth**3 / (6 * softening), beyond)).sum())


def soft_energy(world: Alone, floor: float) -> float:
    """Return kinetic energy, weight, strain and contact with a flat floor of a soft item [J]."""
    mesh, worlds = world.mesh, world.simulation.worlds
    nodes, velocity = worlds.x0.numpy()[0].astype(float), worlds.v.numpy()[0].astype(float)
    corners, moved = mesh.corners, nodes[mesh.cells] - nodes[mesh.cells][:, :1]
    left, _, right = np.linalg.svd(np.einsum("eni,enj->eij", moved, centre_gradients(corners)))
    strain = (moved @ (left @ right) - (corners - corners[:, :1])).reshape(len(moved), 24)
    stiffness = hexahedron_stiffness(corners, mesh.materials[1] * mesh.fill, mesh.materials[2])
    cells, weights = mesh.embed(world.samples.points)
    depth = floor - (weights * nodes[mesh.cells[cells], 2]).sum(axis=1)
    return float(
        (mesh.masses * ((velocity**2).sum(axis=1) / 2 + GRAVITY * nodes[:, 2])).sum()
        + np.einsum("ei,eij,ej->", strain, stiffness, strain) / 2
        + pressed(world.samples.stiffness, np.where(world.samples.kind == TOP, 0, depth), PATH.softening)
    )


@pytest.mark.parametrize("youngs_modulus", [5e3, 3e4, 3e5])
@pytest.mark.parametrize("friction", [0.0, 0.5])
def test_a_soft_block_that_falls_askew_never_gains_energy(youngs_modulus: float, friction: float) -> None:
    item = bar(0.06, 0.04, 0.02, youngs_modulus=youngs_modulus, poisson_ratio=0.3)
    world = alone(item, settings=replace(PATH, friction=friction), undamped=True)
    askew = Rotation.from_rotvec([0.3, 0.12, 0]).apply(world.start)
    askew[:, 2] += 0.01 - askew[:, 2].min()
    world.simulation.place(askew[None], np.zeros((1, 0, 3)), np.zeros((1, 0, 4)))
    assert largest_rise(energies_of(world.simulation, lambda: soft_energy(world, 0.0))) < 1e-6


def test_a_beam_that_swings_never_gains_energy() -> None:
    item = bar(0.12, 0.03, 0.01, youngs_modulus=1e6, poisson_ratio=0.3)
    world = alone(item, settings=PATH, plate=ABYSS, clamped=True, undamped=True)
    assert largest_rise(energies_of(world.simulation, lambda: soft_energy(world, -0.5))) < 1e-6


def boxes_energy(simulation: Simulation, boxes: list[Box], bodies: list[Body], settings: Settings) -> float:
    """Return kinetic energy, weight and contact of boxes on a flat floor [J]."""
    worlds = simulation.worlds
    position, orientation, velocity, spin = (
        getattr(worlds, name).numpy()[0].astype(float) for name in ("p0", "q0", "pv", "qv")
    )
    posed = [
        Box(box.size, centre, turn, box.material)
        for box, centre, turn in zip(boxes, position, orientation, strict=True)
    ]
    total = 0.0
    for box, body, v, turning in zip(posed, bodies, velocity, spin, strict=True):
        own = box.rotation.T @ turning
        total += body.mass * (v @ v / 2 + GRAVITY * box.position[2]) + own @ body.inertia @ own / 2
        points = box.position + body.samples.points @ box.rotation.T
        total += pressed(body.samples.stiffness, ROUNDING - points[:, 2], settings.softening)
        for other in posed:
            if other is not box:
                excess = np.abs((points - other.position) @ other.rotation) - (other.size / 2 - ROUNDING)
                outside = np.linalg.norm(np.maximum(excess, 0), axis=1) + np.minimum(excess.max(axis=1), 0)
                total += pressed(body.samples.stiffness, 2 * ROUNDING - outside, settings.softening)
    return float(total)


@pytest.mark.parametrize(
    ("settings", "undamped", "seed", "rise"),
    [
        *((PATH, True, seed, 5e-4) for seed in (0, 1)),
        *((Settings(), False, seed, 5e-3) for seed in (0, 6, 8, 21)),
        *((replace(Settings(), iterations=20), False, seed, 5e-3) for seed in (5, 9)),  # steps far beyond the search
    ],
)
def test_a_heap_of_fries_that_comes_to_rest_never_gains_energy(
    fry: Callable[..., Box], settings: Settings, undamped: bool, seed: int, rise: float
) -> None:
    """On exact steps but for what friction's springs hold, which is not counted, and the missing gyroscopic torque.

    On the large steps that only look for rest, one that has not converged may leave boxes in each other for a moment:
    of 24 heaps these seeds had the largest rises.
    """
    rng = np.random.default_rng(seed)
    boxes = [fry(*0.012 * rng.normal(size=2), 0.01 + 0.012 * i, rng.uniform(0, np.pi)) for i in range(8)]
    bodies = [box_body(box, settings) for box in boxes]
    simulation = Simulation(plate=FLOOR, mesh=None, samples=None, bodies=bodies, settings=settings, undamped=undamped)
    simulation.place(
        np.zeros((1, 0, 3)),
        np.array([[box.position for box in boxes]]),
        np.array([[box.orientation for box in boxes]]),
    )
    energies = energies_of(simulation, lambda: boxes_energy(simulation, boxes, bodies, settings))
    assert largest_rise(energies) < rise
