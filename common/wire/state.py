"""A state on the wire: its grid, its scene and its item."""

from typing import Annotated, Self

import numpy as np
from pydantic import BaseModel, ConfigDict, Field

from common.domain.bodies import Bodies, Box, Material, Plate
from common.domain.grid import Grid
from common.domain.scene import Item, Scene, State
from common.wire.array import Array

Vector = tuple[float, float, float]
Quaternion = tuple[float, float, float, float]
Profile = Annotated[tuple[float, ...], Field(min_length=2, max_length=1000)]


class Part(BaseModel):
    """A part of a state: finite numbers, no unknown fields."""

    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False)


class GridMessage(Part):
    """Rows along y, columns along x, and the edge of a square cell [m]; the origin is the grid's centre."""

    rows: int = Field(description="Number of cells along y, H.")
    columns: int = Field(description="Number of cells along x, W.")
    cell: float = Field(description="Edge of a cell [m].")

    @classmethod
    def of(cls, grid: Grid) -> Self:
        """Return a grid as a message."""
        return cls(rows=grid.rows, columns=grid.columns, cell=grid.cell)

    def grid(self) -> Grid:
        """Return the grid."""
        return Grid(self.rows, self.columns, self.cell)


class PlateMessage(Part):
    """The plate as a surface of revolution: heights over increasing radii [m], the first radius 0."""

    radii: Profile
    heights: Profile


class BoxMessage(Part):
    """A rigid box: edges [m], centre [m], unit quaternion (x, y, z, w), density [kg/m3], modulus [Pa], ratio [-]."""

    size: Vector = Field(description="Edges [m].")
    position: Vector = Field(description="Centre [m].")
    orientation: Quaternion = Field(description="Unit quaternion (x, y, z, w).")
    density: float = Field(description="[kg/m3]")
    youngs_modulus: float = Field(description="[Pa]")
    poisson_ratio: float = Field(description="[-]")

    @classmethod
    def of(cls, box: Box) -> Self:
        """Return a box as a message."""
        return cls(
            size=box.size.tolist(),
            position=box.position.tolist(),
            orientation=box.orientation.tolist(),
            **vars(box.material),
        )

    def box(self) -> Box:
        """Return the box."""
        material = Material(self.density, self.youngs_modulus, self.poisson_ratio)
        return Box(np.array(self.size), np.array(self.position), np.array(self.orientation), material)


class BodiesMessage(Part):
    """The bodies that made the heightmap, where they are known."""

    plate: PlateMessage | None = None
    boxes: Annotated[tuple[BoxMessage, ...], Field(max_length=1000)] = ()

    @classmethod
    def of(cls, bodies: Bodies) -> Self:
        """Return bodies as a message."""
        plate = bodies.plate and PlateMessage(radii=bodies.plate.radii.tolist(), heights=bodies.plate.heights.tolist())
        return cls(plate=plate, boxes=tuple(BoxMessage.of(box) for box in bodies.boxes))

    def bodies(self) -> Bodies:
        """Return the bodies."""
        plate = self.plate and Plate(np.array(self.plate.radii), np.array(self.plate.heights))
        return Bodies(plate, tuple(box.box() for box in self.boxes))


class ItemMessage(Part):
    """Thickness ``(H, W)`` [m] and materials ``(3, H, W)`` of the item, centred on the grid."""

    heights: Array = Field(description="Thickness (H, W) [m], 0 outside the outline.")
    materials: Array = Field(description="Density [kg/m3], Young's modulus [Pa], Poisson's ratio [-] (3, H, W).")


class SceneMessage(Part):
    """Heights ``(H, W)`` [m], materials ``(3, H, W)`` (density, Young's modulus, Poisson's ratio), known bodies."""

    heights: Array = Field(description="The surface seen from above (H, W) [m].")
    materials: Array = Field(description="As the item's, of the topmost thing (3, H, W); 0 where there is none.")
    bodies: BodiesMessage | None = None


class StateMessage(Part):
    """Scene and item on one grid: what does not change during one optimisation."""

    grid: GridMessage
    scene: SceneMessage
    item: ItemMessage

    @classmethod
    def of(cls, state: State) -> Self:
        """Return a state as a message."""
        scene, item = state.scene, state.item
        return cls(
            grid=GridMessage.of(state.grid),
            scene=SceneMessage(
                heights=Array.of(scene.heights),
                materials=Array.of(scene.materials),
                bodies=None if scene.bodies is None else BodiesMessage.of(scene.bodies),
            ),
            item=ItemMessage(heights=Array.of(item.heights), materials=Array.of(item.materials)),
        )

    def state(self) -> State:
        """Return the state.

        Raises:
            RequestError: Shapes do not fit the grid, or values are not finite or out of range.
        """
        bodies = None if self.scene.bodies is None else self.scene.bodies.bodies()
        scene = Scene(self.grid.grid(), self.scene.heights.values(), self.scene.materials.values(), bodies)
        return State(scene, Item(self.item.heights.values(), self.item.materials.values()))
