"""Items for the plating task: outlines, thicknesses and the heightmap and masks drawn from them."""

from abc import ABC, abstractmethod
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from common.domain.bodies import Material
from common.domain.errors import RequestError
from common.domain.grid import Floats, Grid
from common.domain.scene import Item


class Outline(ABC):
    """The outline of an item seen from above, in a frame (u, v) of its own."""

    @property
    @abstractmethod
    def reach(self) -> float:
        """Radius of a circle about the frame's origin that holds the whole outline [m]."""

    @abstractmethod
    def contains(self, u: Floats, v: Floats) -> NDArray[np.bool_]:
        """Return whether each point lies inside, same shape as ``u`` and ``v`` [m]."""


@dataclass(frozen=True)
class RoundedRectangle(Outline):
    """A rectangle of ``length`` along u and ``width`` along v with rounded corners of radius ``corner`` [m]."""

    length: float
    width: float
    corner: float

    @property
    def reach(self) -> float:
        """Half of the diagonal [m]."""
        return float(np.hypot(self.length, self.width)) / 2

    def contains(self, u: Floats, v: Floats) -> NDArray[np.bool_]:
        """Return whether the distance to the inner rectangle is at most ``corner``."""
        beyond_u = np.maximum(np.abs(u) - (self.length / 2 - self.corner), 0)
        beyond_v = np.maximum(np.abs(v) - (self.width / 2 - self.corner), 0)
        return np.hypot(beyond_u, beyond_v) <= self.corner


@dataclass(frozen=True)
class Wavy(Outline):
    """An ellipse whose radius is multiplied by ``1 + sum_k a_k cos(k angle + phase_k)``, k = 2, 3, ...

    Without amplitudes it is an ellipse.

    Attributes:
        length: Axis along u [m].
        width: Axis along v [m].
        amplitudes: ``a_k``, their absolute values adding up to less than 1 [-].
        phases: ``phase_k`` [rad].
    """

    length: float
    width: float
    amplitudes: tuple[float, ...] = ()
    phases: tuple[float, ...] = ()

    @property
    def reach(self) -> float:
        """Half of the longer axis with all waves added up [m]."""
        return max(self.length, self.width) / 2 * (1 + sum(abs(amplitude) for amplitude in self.amplitudes))

    def contains(self, u: Floats, v: Floats) -> NDArray[np.bool_]:
        """Return whether the point's elliptic radius is at most the wavy one."""
        across, along = 2 * v / self.width, 2 * u / self.length
        angle = np.arctan2(across, along)
        radius = np.ones_like(angle)
        for order, (amplitude, phase) in enumerate(zip(self.amplitudes, self.phases, strict=True), start=2):
            radius += amplitude * np.cos(order * angle + phase)
        return np.hypot(across, along) <= radius


@dataclass(frozen=True)
class TwoLobes(Outline):
    """A T-bone: a large and a small elliptic lobe side by side along u, joined by a straight bone along v.

    Attributes:
        length: Whole length along u [m].
        width: Axis of the large lobe along v [m].
        small_share: Share of the length that the small lobe takes, between 0.2 and 0.5 [-].
    """

    length: float
    width: float
    small_share: float

    @property
    def reach(self) -> float:
        """A circle about the bone [m]."""
        return float(np.hypot(self.length, self.width))

    def contains(self, u: Floats, v: Floats) -> NDArray[np.bool_]:
        """Return whether the point is in a lobe or in the bone, the frame's origin being on the bone."""
        inside = np.zeros(np.broadcast_shapes(u.shape, v.shape), dtype=bool)
        bone, overlap = 0.12 * self.length, 0.15 * self.length
        for side, share, width in ((1, 1 - self.small_share, self.width), (-1, self.small_share, 0.72 * self.width)):
            axis = share * self.length + overlap
            centre = side * (share * self.length - axis / 2)
            inside |= np.hypot(2 * (u - centre) / axis, 2 * v / width) <= 1
        return inside | ((np.abs(u) <= bone / 2) & (np.abs(v) <= 0.42 * self.width))


def draw_item(
    grid: Grid,
    outline: Outline,
    *,
    thickness: float,
    material: Material,
    angle: float = 0.0,
    taper: tuple[float, float] = (0.0, 0.0),
) -> Item:
    """Draw an item with its centre of area at the grid's centre, as point samples at the cells' centres.

    Args:
        grid: The grid to draw on.
        outline: The item's outline.
        thickness: Thickness at the centre [m].
        material: What the item is made of.
        angle: Rotation from the outline's frame to the grid, about z [rad].
        taper: Relative change of the thickness from the centre to ``outline.reach`` along u and along v [-].

    Raises:
        RequestError: The item does not fit on the grid.
    """
    centre_u, centre_v = _centre(outline)
    cos, sin = np.cos(angle), np.sin(angle)
    x, y = grid.x[None, :], grid.y[:, None]
    u, v = cos * x + sin * y, cos * y - sin * x
    inside = outline.contains(u + centre_u, v + centre_v)
    if not inside.any() or inside[0].any() or inside[-1].any() or inside[:, 0].any() or inside[:, -1].any():
        raise RequestError(
            f"expected an item that fits on a grid of {grid.half_extent[0] * 2:g} x {grid.half_extent[1] * 2:g} m, "
            f"got {outline}"
        )
    heights = np.where(inside, thickness * (1 + (taper[0] * u + taper[1] * v) / outline.reach), 0.0)
    properties = np.array([material.density, material.youngs_modulus, material.poisson_ratio])
    return Item(heights.astype(np.float32), (properties[:, None, None] * inside).astype(np.float32))


def _centre(outline: Outline) -> tuple[float, float]:
    """Return the centre of the outline's area in its own frame [m]."""
    lattice = np.linspace(-1, 1, 501) * outline.reach
    u, v = np.meshgrid(lattice, lattice)
    inside = outline.contains(u, v)
    return float(u[inside].mean()), float(v[inside].mean())
