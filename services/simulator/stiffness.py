"""Stiffness of hexahedra with Wilson's incompatible modes."""

import numpy as np
from numpy.typing import NDArray

CORNERS = np.array(
    [[-1, -1, -1], [1, -1, -1], [1, 1, -1], [-1, 1, -1], [-1, -1, 1], [1, -1, 1], [1, 1, 1], [-1, 1, 1]],
    dtype=np.float64,
)
"""Natural coordinates of the eight nodes, the bottom four first ``(8, 3)``."""

GAUSS = CORNERS / np.sqrt(3.0)


def shape_gradients(natural: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return dN/d(xi, eta, zeta) of the eight trilinear shape functions at one point ``(3,)`` as ``(8, 3)``."""
    factors = 1 + CORNERS * natural
    gradients = np.empty((8, 3))
    for axis in range(3):
        first, second = (axis + 1) % 3, (axis + 2) % 3
        gradients[:, axis] = CORNERS[:, axis] * factors[:, first] * factors[:, second] / 8
    return gradients


def centre_gradients(corners: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return dN/dX at the centres of hexahedra with corners ``(E, 8, 3)`` [m] as ``(E, 8, 3)`` [1/m]."""
    natural = shape_gradients(np.zeros(3))
    return natural @ np.linalg.inv(np.einsum("eni,nj->eij", corners, natural))


def volumes(corners: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the volumes of hexahedra with corners ``(E, 8, 3)`` [m] as ``(E,)`` [m3]."""
    total = np.zeros(len(corners))
    for point in GAUSS:
        total += np.linalg.det(np.einsum("eni,nj->eij", corners, shape_gradients(point)))
    return total


def hexahedron_stiffness(
    corners: NDArray[np.float64], youngs_modulus: NDArray[np.float64], poisson_ratio: NDArray[np.float64]
) -> NDArray[np.float64]:
    """Return the stiffness matrices of hexahedra, incompatible modes condensed out.

    ``K = K_uu - K_ua K_aa^-1 K_au`` with ``K = sum_g det(J) [B G]^T D [B G]`` over 2 x 2 x 2 Gauss points, ``B`` the
    strains of the nodes and ``G`` those of the modes 1 - xi^2, 1 - eta^2, 1 - zeta^2, taken with the Jacobian at the
    centre so that the element passes the patch test (Taylor, Beresford and Wilson 1976).

    Args:
        corners: Nodes in the order of `CORNERS` ``(E, 8, 3)`` [m].
        youngs_modulus: ``(E,)`` [Pa].
        poisson_ratio: ``(E,)`` [-], below 0.5.

    Returns:
        ``(E, 24, 24)`` [N/m], nodes slowest, x, y, z fastest.
    """
    count = len(corners)
    elasticity = _elasticity(youngs_modulus, poisson_ratio)
    centre = np.einsum("eni,nj->eij", corners, shape_gradients(np.zeros(3)))
    centre_inverse, centre_volume = np.linalg.inv(centre), np.linalg.det(centre)
    full = np.zeros((count, 33, 33))
    for point in GAUSS:
        natural = shape_gradients(point)
        jacobian = np.einsum("eni,nj->eij", corners, natural)
        volume = np.linalg.det(jacobian)
        gradients = natural @ np.linalg.inv(jacobian)
        modes = np.diag(-2 * point) @ centre_inverse * (centre_volume / volume)[:, None, None]
        strains = _strains(np.concatenate([gradients, modes], axis=1))
        full += strains.transpose(0, 2, 1) @ elasticity @ strains * volume[:, None, None]
    nodes, coupling, inner = full[:, :24, :24], full[:, :24, 24:], full[:, 24:, 24:]
    return nodes - coupling @ np.linalg.solve(inner, coupling.transpose(0, 2, 1))


def _elasticity(youngs_modulus: NDArray[np.float64], poisson_ratio: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return Hooke's law for strains xx, yy, zz, xy, yz, zx ``(E, 6, 6)`` [Pa]."""
    shear = youngs_modulus / (2 * (1 + poisson_ratio))
    lame = youngs_modulus * poisson_ratio / ((1 + poisson_ratio) * (1 - 2 * poisson_ratio))
    law = np.zeros((len(youngs_modulus), 6, 6))
    law[:, :3, :3] = lame[:, None, None]
    for i in range(3):
        law[:, i, i] += 2 * shear
        law[:, i + 3, i + 3] = shear
    return law


def _strains(gradients: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the matrices from displacements to strains ``(E, 6, 3n)`` for gradients ``(E, n, 3)``."""
    count, functions = gradients.shape[:2]
    strains = np.zeros((count, 6, functions, 3))
    for axis in range(3):
        strains[:, axis, :, axis] = gradients[:, :, axis]
    for row, (first, second) in enumerate(((0, 1), (1, 2), (2, 0)), start=3):
        strains[:, row, :, first] = gradients[:, :, second]
        strains[:, row, :, second] = gradients[:, :, first]
    return strains.reshape(count, 6, 3 * functions)
