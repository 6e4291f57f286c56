import json
from pathlib import Path

import numpy as np
import pytest
from scipy.sparse import coo_matrix
from scipy.sparse.linalg import spsolve

from services.simulator.stiffness import CORNERS, hexahedron_stiffness, volumes

REFERENCE = json.loads((Path(__file__).parents[3] / "references" / "cantilever.json").read_text())


def distorted() -> np.ndarray:
    rng = np.random.default_rng(3)
    return ((CORNERS + 1) / 2 * [0.01, 0.012, 0.007] + rng.normal(size=(8, 3)) * 4e-4)[None]


def test_a_constant_strain_costs_exactly_its_energy_in_a_distorted_element() -> None:
    corners, gradient = distorted(), np.random.default_rng(1).normal(size=(3, 3)) * 0.01
    stiffness = hexahedron_stiffness(corners, np.array([1e5]), np.array([0.4]))[0]
    displacement = (corners[0] @ gradient.T).ravel()
    strain = (gradient + gradient.T) / 2
    shear, lame = 1e5 / 2.8, 1e5 * 0.4 / (1.4 * 0.2)
    energy = volumes(corners)[0] * (shear * (strain**2).sum() + lame / 2 * np.trace(strain) ** 2)
    assert displacement @ stiffness @ displacement / 2 == pytest.approx(energy, rel=1e-9)


def test_only_rigid_motions_are_free() -> None:
    eigenvalues = np.linalg.eigvalsh(hexahedron_stiffness(distorted(), np.array([1.0]), np.array([0.3]))[0])
    assert np.abs(eigenvalues[:6]).max() < 1e-12
    assert eigenvalues[6] > 1e-5


@pytest.mark.parametrize(
    ("cells", "poisson_ratio", "error"),
    [((12, 2, 3), 0.3, 0.02), ((12, 2, 3), 0.45, 0.04), ((24, 4, 4), 0.3, 0.01), ((24, 4, 4), 0.45, 0.015)],
)
def test_a_cantilever_sags_as_far_as_the_converged_solution(
    cells: tuple[int, int, int], poisson_ratio: float, error: float
) -> None:
    shape = np.array(cells) + 1
    lattice = np.stack(np.meshgrid(*map(np.arange, shape), indexing="ij"), axis=-1)
    points = lattice.reshape(-1, 3) * np.array([0.14, 0.02, 0.02]) / cells
    base = lattice[:-1, :-1, :-1].reshape(-1, 3)
    hexahedra = np.stack([np.ravel_multi_index((base + (CORNERS[i] > 0)).T, shape) for i in range(8)], axis=1)
    count = len(hexahedra)
    blocks = hexahedron_stiffness(points[hexahedra], np.full(count, 1e6), np.full(count, poisson_ratio))
    freedoms = (3 * hexahedra[:, :, None] + np.arange(3)).reshape(count, 24)
    rows, columns = np.repeat(freedoms, 24, axis=1), np.tile(freedoms, 24)
    stiffness = coo_matrix((blocks.ravel(), (rows.ravel(), columns.ravel()))).tocsr()
    weight = np.repeat(1050 * 9.81 * volumes(points[hexahedra]) / 8, 8)
    force = np.zeros(3 * len(points))
    np.add.at(force, 3 * hexahedra.ravel() + 2, -weight)
    free = np.flatnonzero(np.repeat(points[:, 0] > 1e-9, 3))
    solution = np.zeros(3 * len(points))
    solution[free] = spsolve(stiffness[free][:, free].tocsc(), force[free])
    tip = -solution[2::3][points[:, 0] > 0.14 - 1e-9].mean()
    assert tip == pytest.approx(REFERENCE["deflection_m"][f"{poisson_ratio:g}"], rel=error)
