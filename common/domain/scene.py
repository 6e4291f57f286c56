"""Scene, item and state: what does not change during one optimisation."""

import hashlib
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from common.domain.bodies import Bodies
from common.domain.errors import RequestError
from common.domain.grid import Grid, check_heightmap, check_materials

RIGID_MODULUS = 1e8
"""An item whose Young's modulus is this or more everywhere is one rigid body [Pa]."""


@dataclass(frozen=True)
class Scene:
    """What is on the plate before the item comes, ``I_0`` in the paper.

    Attributes:
        grid: The grid of all arrays.
        heights: Heightmap ``(H, W)`` [m].
        materials: Density, Young's modulus, Poisson's ratio of the topmost thing ``(3, H, W)``; 0 on bare plate.
        bodies: The bodies that made the heightmap, or None if only the heightmap is known.
    """

    grid: Grid
    heights: NDArray[np.float32]
    materials: NDArray[np.float32]
    bodies: Bodies | None = None

    def __post_init__(self) -> None:
        object.__setattr__(self, "heights", check_heightmap("scene.heights", self.heights, self.grid))
        object.__setattr__(self, "materials", check_materials("scene.materials", self.materials, self.grid))


@dataclass(frozen=True)
class Item:
    """The object to place, ``I_obj`` in the paper, centred on the grid and lying flat.

    Attributes:
        heights: Thickness at each cell, 0 outside the outline ``(H, W)`` [m].
        materials: Density, Young's modulus, Poisson's ratio ``(3, H, W)``; 0 outside the outline.
    """

    heights: NDArray[np.float32]
    materials: NDArray[np.float32]

    @property
    def outline(self) -> NDArray[np.bool_]:
        """Where the item is ``(H, W)``."""
        return self.heights > 0

    @property
    def is_rigid(self) -> bool:
        """Whether the whole item is one rigid body."""
        return bool((self.materials[1][self.outline] >= RIGID_MODULUS).all())


@dataclass(frozen=True)
class State:
    """Scene and item on one grid, ``s_0`` in the paper.

    Raises:
        RequestError: An array has the wrong shape or values, or the item is empty or has no material.
    """

    scene: Scene
    item: Item

    def __post_init__(self) -> None:
        heights = check_heightmap("item.heights", self.item.heights, self.grid)
        materials = check_materials("item.materials", self.item.materials, self.grid)
        if float(heights.min()) < 0 or not (heights > 0).any():
            raise RequestError("item.heights: expected thicknesses of 0 or more and some above 0")
        if (materials[:2][:, heights > 0] <= 0).any():
            raise RequestError("item.materials: expected density and Young's modulus above 0 wherever the item is")
        object.__setattr__(self, "item", Item(heights, materials))

    @property
    def grid(self) -> Grid:
        """The grid of all arrays."""
        return self.scene.grid

    @cached_property
    def digest(self) -> str:
        """Content address: SHA-256 in hex over the numbers in little-endian bytes, in the order of the fields.

        ``rows, columns`` as int64, ``cell`` as float64, then scene heights and materials, item heights and
        materials as float32 in C order; where bodies are known, one byte 1 if the plate is known and else 0, then
        radii and heights, then each box's size, position, orientation, density, Young's modulus and Poisson's
        ratio, all as float64.
        """
        parts: list[bytes] = [
            np.array(self.grid.shape, "<i8").tobytes(),
            np.array([self.grid.cell], "<f8").tobytes(),
            *(
                np.ascontiguousarray(array, "<f4").tobytes()
                for array in (
                    self.scene.heights,
                    self.scene.materials,
                    self.item.heights,
                    self.item.materials,
                )
            ),
        ]
        bodies = self.scene.bodies
        if bodies is not None:
            numbers: list[NDArray[np.float64]] = []
            if bodies.plate is not None:
                numbers += [bodies.plate.radii, bodies.plate.heights]
            for box in bodies.boxes:
                material = [box.material.density, box.material.youngs_modulus, box.material.poisson_ratio]
                numbers += [box.size, box.position, box.orientation, np.array(material)]
            parts.append(bytes([bodies.plate is not None]))
            parts += [np.ascontiguousarray(values, "<f8").tobytes() for values in numbers]
        return hashlib.sha256(b"".join(parts)).hexdigest()
