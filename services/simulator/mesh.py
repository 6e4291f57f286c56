"""A mesh of hexahedra that follows an item's heightmap."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from services.simulator.outline import Outline
from services.simulator.settings import Settings
from services.simulator.stiffness import CORNERS, volumes

SUBPOINTS = 12
"""Points along each edge of a cell at which its cover and thickness are measured."""

SMALLEST_COVER = 0.04
"""Share of a cell's area below which it is left out; its neighbours stretch over the rest."""

SMALLEST_GAIN = 0.92
"""A turned mesh is used if its bounding rectangle has less than this share of the upright one's area."""


@dataclass(frozen=True)
class Mesh:
    """Hexahedra in columns over a regular, possibly turned, lattice of the plane.

    Attributes:
        positions: Nodes in the item's frame, lattice x slowest, z fastest ``(N, 3)`` [m].
        cells: Node indices of each hexahedron, in the order of `stiffness.CORNERS` ``(E, 8)``.
        materials: Density, Young's modulus, Poisson's ratio of each hexahedron ``(3, E)``.
        fill: Share of each hexahedron's volume that the item takes ``(E,)``.
        origin: Corner of the lattice in the item's frame ``(2,)`` [m].
        axes: The lattice's two directions, one a row ``(2, 2)``.
        spacing: Edges of a lattice cell ``(2,)`` [m].
        columns: Hexahedron at the bottom of each lattice cell, the nearest one where there is none ``(I, J)``.
        heights: Height of the node columns ``(I + 1, J + 1)`` [m].
        layers: Hexahedra in a column.
    """

    positions: NDArray[np.float64]
    cells: NDArray[np.int32]
    materials: NDArray[np.float64]
    fill: NDArray[np.float64]
    origin: NDArray[np.float64]
    axes: NDArray[np.float64]
    spacing: NDArray[np.float64]
    columns: NDArray[np.int32]
    heights: NDArray[np.float64]
    layers: int

    @property
    def corners(self) -> NDArray[np.float64]:
        """Positions of each hexahedron's nodes ``(E, 8, 3)`` [m]."""
        return self.positions[self.cells]

    @property
    def masses(self) -> NDArray[np.float64]:
        """Lumped mass of each node ``(N,)`` [kg]."""
        share = self.materials[0] * self.fill * volumes(self.corners) / 8
        return np.bincount(self.cells.ravel(), np.repeat(share, 8), minlength=len(self.positions)).astype(np.float64)

    def embed(self, points: NDArray[np.float64]) -> tuple[NDArray[np.int32], NDArray[np.float64]]:
        """Return hexahedron ``(P,)`` and trilinear weights of its nodes ``(P, 8)`` for points ``(P, 3)`` [m].

        Points outside the mesh get the weights of the nearest column, extrapolated.
        """
        lattice = (points[:, :2] - self.origin) @ self.axes.T / self.spacing
        cell = np.clip(np.floor(lattice).astype(np.intp), 0, np.array(self.columns.shape) - 1)
        bottom = self.columns[cell[:, 0], cell[:, 1]]
        lower_left = self.positions[self.cells[bottom, 0], :2]
        plane = (points[:, :2] - lower_left) @ self.axes.T / self.spacing
        column = self.cells[bottom + self.layers - 1, 4:]  # the top four nodes
        flat = (1 + CORNERS[:4, :2] * (2 * plane[:, None, :] - 1)).prod(axis=2) / 4
        height = (flat * self.positions[column, 2]).sum(axis=1)
        level = points[:, 2] / height * self.layers
        layer = np.clip(np.floor(level).astype(np.intp), 0, self.layers - 1)
        rise = (level - layer)[:, None]
        weights = np.concatenate([flat * (1 - rise), flat * rise], axis=1)
        weights[np.abs(weights) < 1e-7] = 0
        return (bottom + layer).astype(np.int32), weights


def build_mesh(outline: Outline, settings: Settings) -> Mesh:
    """Cover an item with hexahedra of about `Settings.cell`, as long as wide.

    Cells at the border count by the share that the item covers; node columns are as high as the item is around them.
    """
    origin, axes, extent = _bounding_rectangle(outline)
    shape = np.maximum(np.round(extent / settings.cell).astype(np.intp), 2)
    spacing = extent / shape
    fractions = (np.arange(SUBPOINTS) + 0.5) / SUBPOINTS
    lattice = np.stack(
        np.meshgrid(
            *((np.arange(count)[:, None] + fractions).ravel() for count in shape),
            indexing="ij",
        ),
        axis=-1,
    )
    rows, columns, covered = outline.locate(origin + (lattice.reshape(-1, 2) * spacing) @ axes)
    blocks = (shape[0], SUBPOINTS, shape[1], SUBPOINTS)
    covered_blocks = covered.reshape(blocks)
    cover = covered_blocks.mean(axis=(1, 3))
    thickness = np.where(covered, outline.thickness[rows, columns], 0).reshape(blocks)
    heights = _column_heights(thickness, covered_blocks, fractions)
    kept = cover >= SMALLEST_COVER
    weight = np.maximum(covered_blocks.sum(axis=(1, 3)), 1)
    materials = np.stack(
        [np.where(covered, channel[rows, columns], 0).reshape(blocks).sum(axis=(1, 3)) for channel in outline.materials]
    )
    materials = (materials / weight)[:, kept]
    mean_thickness = (thickness.sum(axis=(1, 3)) / weight)[kept]
    node_mean = (heights[:-1, :-1] + heights[1:, :-1] + heights[:-1, 1:] + heights[1:, 1:])[kept] / 4
    materials[1] = np.minimum(materials[1], settings.stiffest)
    positions, cells = _number(kept, heights, origin, axes, spacing, settings.layers)
    return Mesh(
        positions=positions,
        cells=cells,
        materials=np.repeat(materials, settings.layers, axis=1),
        fill=np.repeat(cover[kept] * mean_thickness / node_mean, settings.layers),
        origin=origin,
        axes=axes,
        spacing=spacing,
        columns=_nearest_columns(kept, settings.layers),
        heights=heights,
        layers=settings.layers,
    )


def _bounding_rectangle(outline: Outline) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.float64]]:
    """Return corner ``(2,)``, axes ``(2, 2)`` (the longer first) and extent ``(2,)`` of a tight rectangle [m]."""
    centres = outline.centres
    half = outline.pixel / 2
    pixels = np.concatenate([centres + half * np.array(sign) for sign in ((-1, -1), (1, -1), (1, 1), (-1, 1))])
    covariance = np.cov(centres.T) if len(centres) > 1 else np.eye(2)
    candidates = [np.eye(2)]
    if abs(covariance[0, 1]) > 1e-3 * np.trace(covariance):
        candidates.append(np.linalg.eigh(covariance)[1].T)
    best = None
    for axes in candidates:
        projected = pixels @ axes.T
        low, high = projected.min(axis=0), projected.max(axis=0)
        extent = high - low
        if best is None or extent.prod() < SMALLEST_GAIN * best[2].prod():
            best = (low, axes, extent)
    assert best is not None
    low, axes, extent = best
    if extent[1] > extent[0]:
        low, axes, extent = low[::-1], axes[::-1], extent[::-1]
    if np.linalg.det(axes) < 0:  # keep the lattice right-handed, or the hexahedra are inside out
        low = np.array([low[0], -low[1] - extent[1]])
        axes = np.stack([axes[0], -axes[1]])
    return low @ axes, axes, extent


def _column_heights(
    thickness: NDArray[np.float64], covered: NDArray[np.bool_], fractions: NDArray[np.float64]
) -> NDArray[np.float64]:
    """Return the item's mean thickness around each lattice point, weighted by a hat ``(I + 1, J + 1)`` [m]."""
    shape = (thickness.shape[0] + 1, thickness.shape[2] + 1)
    total, count = np.zeros(shape), np.zeros(shape)
    for i, along in enumerate((1 - fractions, fractions)):
        for j, across in enumerate((1 - fractions, fractions)):
            window = (slice(i, shape[0] - 1 + i), slice(j, shape[1] - 1 + j))
            total[window] += np.einsum("iajb,a,b->ij", thickness, along, across)
            count[window] += np.einsum("iajb,a,b->ij", covered.astype(np.float64), along, across)
    return total / np.maximum(count, 1e-9)


def _number(
    kept: NDArray[np.bool_],
    heights: NDArray[np.float64],
    origin: NDArray[np.float64],
    axes: NDArray[np.float64],
    spacing: NDArray[np.float64],
    layers: int,
) -> tuple[NDArray[np.float64], NDArray[np.int32]]:
    """Return node positions ``(N, 3)`` [m] and hexahedra ``(E, 8)``; only nodes of kept cells get a number."""
    used: NDArray[np.bool_] = np.zeros(heights.shape, dtype=np.bool_)
    for i, j in ((0, 0), (1, 0), (0, 1), (1, 1)):
        used[i : used.shape[0] - 1 + i, j : used.shape[1] - 1 + j] |= kept
    column = np.cumsum(used).reshape(heights.shape) - 1
    lattice = np.argwhere(used)
    plane = origin + (lattice * spacing) @ axes
    levels = np.linspace(0, 1, layers + 1)
    z = heights[used][:, None] * levels
    positions = np.concatenate([np.repeat(plane[:, None, :], layers + 1, axis=1), z[:, :, None]], axis=2).reshape(-1, 3)
    cell = np.argwhere(kept)
    base = np.stack(
        [column[cell[:, 0] + i, cell[:, 1] + j] * (layers + 1) for i, j in ((0, 0), (1, 0), (1, 1), (0, 1))], axis=1
    )
    below = base[:, None, :] + np.arange(layers)[None, :, None]
    return positions, np.concatenate([below, below + 1], axis=2).reshape(-1, 8).astype(np.int32)


def _nearest_columns(kept: NDArray[np.bool_], layers: int) -> NDArray[np.int32]:
    """Return the bottom hexahedron of the kept cell nearest to each lattice cell ``(I, J)``."""
    cells = np.argwhere(kept)
    every = np.argwhere(np.ones(kept.shape, dtype=bool))
    distance = ((every[:, None, :] - cells[None, :, :]) ** 2).sum(axis=2)
    return (distance.argmin(axis=1).reshape(kept.shape) * layers).astype(np.int32)
