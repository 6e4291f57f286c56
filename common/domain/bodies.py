"""Known rigid bodies of a scene: the plate as a surface of revolution and boxes with rounded edges."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from common.domain.errors import RequestError
from common.domain.grid import Floats, Grid

ROUNDING = 1.5e-3
"""Radius of a box's edges [m]; simulator and renderer use the same shape."""


@dataclass(frozen=True)
class Material:
    """A homogeneous elastic material.

    Attributes:
        density: Mass per volume [kg/m3].
        youngs_modulus: Stiffness [Pa]; 1e8 or more means rigid.
        poisson_ratio: Lateral contraction [-], in [0, 0.5).
    """

    density: float
    youngs_modulus: float
    poisson_ratio: float

    def __post_init__(self) -> None:
        if not (self.density > 0 and self.youngs_modulus > 0 and 0 <= self.poisson_ratio < 0.5):
            raise RequestError(
                "expected density > 0, Young's modulus > 0 and Poisson's ratio in [0, 0.5), got "
                f"{self.density:g}, {self.youngs_modulus:g}, {self.poisson_ratio:g}"
            )


@dataclass(frozen=True)
class Plate:
    """A plate (and the table around it) as a surface of revolution, height over radius.

    Attributes:
        radii: Increasing radii of the profile's points, the first 0 ``(K,)`` [m].
        heights: Height of the surface at each radius ``(K,)`` [m]; the last one continues outwards as the table.
    """

    radii: NDArray[np.float64]
    heights: NDArray[np.float64]

    def __post_init__(self) -> None:
        radii = np.array(self.radii, dtype=np.float64)
        heights = np.array(self.heights, dtype=np.float64)
        if radii.ndim != 1 or radii.shape != heights.shape or not 2 <= len(radii) <= 1000:
            raise RequestError(
                f"plate: expected 2 to 1000 radii and as many heights, got {radii.shape}, {heights.shape}"
            )
        if not (np.isfinite(radii).all() and np.isfinite(heights).all()):
            raise RequestError("plate: expected finite radii and heights")
        if radii[0] != 0 or (np.diff(radii) <= 0).any():
            raise RequestError("plate: expected radii that start at 0 and increase")
        object.__setattr__(self, "radii", radii)
        object.__setattr__(self, "heights", heights)

    def height(self, radius: Floats) -> NDArray[np.float64]:
        """Return the surface's height at each radius, same shape [m]."""
        return np.interp(radius, self.radii, self.heights)

    def heightmap(self, grid: Grid) -> NDArray[np.float64]:
        """Return the bare plate's heights at the cells' centres ``(H, W)`` [m]."""
        return self.height(np.hypot(grid.x[None, :], grid.y[:, None]))


@dataclass(frozen=True)
class Box:
    """A rigid box with edges rounded by `ROUNDING`, for instance a fry.

    Attributes:
        size: Full edge lengths, rounding included ``(3,)`` [m].
        position: Centre ``(3,)`` [m].
        orientation: Unit quaternion, scalar last ``(x, y, z, w)``: body to world.
        material: What the box is made of.
    """

    size: NDArray[np.float64]
    position: NDArray[np.float64]
    orientation: NDArray[np.float64]
    material: Material

    def __post_init__(self) -> None:
        for name, length in (("size", 3), ("position", 3), ("orientation", 4)):
            values = np.array(getattr(self, name), dtype=np.float64)
            if values.shape != (length,) or not np.isfinite(values).all():
                raise RequestError(f"box: expected {length} finite numbers as its {name}, got {values!r}")
            object.__setattr__(self, name, values)
        if (self.size < 2 * ROUNDING).any():
            raise RequestError(f"box: expected edges of at least {2 * ROUNDING} m, got {self.size}")
        norm = float(np.linalg.norm(self.orientation))
        if abs(norm - 1) > 1e-3:
            raise RequestError(f"box: expected a unit quaternion, got one of length {norm:g}")
        if abs(norm - 1) > 1e-12:  # a unit quaternion keeps its bits, and so its state's digest, on every hop
            object.__setattr__(self, "orientation", self.orientation / norm)

    @property
    def rotation(self) -> NDArray[np.float64]:
        """Rotation matrix from body to world ``(3, 3)``."""
        x, y, z, w = self.orientation
        return np.array(
            [
                [1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)],
                [2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)],
                [2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)],
            ]
        )

    def top(self, x: Floats, y: Floats) -> NDArray[np.float64]:
        """Return the height of the box's upper surface over each point, -inf where it is not [m].

        A ray from above enters the box without rounding and is marched from there along the signed distance of the
        rounded box until it touches.
        """
        x, y = np.broadcast_arrays(np.asarray(x, dtype=np.float64), np.asarray(y, dtype=np.float64))
        rotation, half = self.rotation, self.size / 2
        reach = float(np.linalg.norm(half))
        start = np.stack([x - self.position[0], y - self.position[1], np.full(x.shape, reach)], axis=-1) @ rotation
        down = -rotation[2]
        slope = np.where(np.abs(down) < 1e-9, 1e-9, down)
        crossings = (np.stack([-half, half])[:, None] - start.reshape(-1, 3)) / slope
        travelled, leaves = crossings.min(axis=0).max(axis=1), crossings.max(axis=0).min(axis=1)
        index = np.flatnonzero(travelled < leaves)
        point, travelled, leaves = start.reshape(-1, 3)[index], travelled[index], leaves[index]
        top = np.full(x.size, -np.inf)
        for _ in range(64):
            excess = np.abs(point + travelled[:, None] * down) - (half - ROUNDING)
            gap = np.linalg.norm(np.maximum(excess, 0), axis=1) + np.minimum(excess.max(axis=1), 0) - ROUNDING
            touching = gap < 1e-7
            top[index[touching]] = self.position[2] + reach - travelled[touching] - gap[touching]
            going = ~touching & (travelled < leaves)
            if not going.any():
                break
            index, point, leaves = index[going], point[going], leaves[going]
            travelled = travelled[going] + gap[going]
        return top.reshape(x.shape)


@dataclass(frozen=True)
class Bodies:
    """What is known of a scene's bodies, settled and at rest.

    Attributes:
        plate: The plate, or None if it has to be found in the heightmap.
        boxes: The boxes, fries for instance.
    """

    plate: Plate | None
    boxes: tuple[Box, ...]
