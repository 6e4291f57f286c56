"""Messages of the world's stand-in: what a camera sees of a table, and of what an action led to."""

from typing import Annotated, Self

import numpy as np
from pydantic import Field

from common.domain.bodies import Material
from common.domain.camera import Camera
from common.domain.errors import ModelError, RequestError
from common.domain.grid import Floats
from common.domain.world import Sight
from common.wire.array import Array
from common.wire.messages import Reply, Request

Numbers3 = tuple[float, float, float]
Row = tuple[float, float, float, float]
Table = Annotated[int, Field(ge=0, lt=2**31, description="Number of a table: a plate, fries and an item.")]


class LookRequest(Request):
    """Asks what a camera sees of a table before anything is placed."""

    table: Table


class LookReply(Reply):
    """Depth images ``(h, w)`` [m], 0 where there is none, and what the robot knows of camera and materials."""

    before: Array = Field(description="Plate and fries (h, w) [m].")
    item: Array = Field(description="The item alone on the empty plate (h, w) [m].")
    plate: Array | None = Field(description="The empty plate (h, w) [m]; null: nobody took an image of it.")
    intrinsics: Row = Field(description="fx, fy, cx, cy [pixel].")
    pose: tuple[Row, Row, Row, Row] = Field(description="From the camera's to the plate's frame, as calibrated [m].")
    item_material: Numbers3 = Field(description="Density [kg/m3], Young's modulus [Pa], Poisson's ratio.")
    scene_material: Numbers3 = Field(description="The same of what lies on the plate.")
    name: str = Field(description="What the item is called.")
    instance: str

    @classmethod
    def of(cls, sight: Sight, *, instance: str) -> Self:
        """Return what is seen as a message."""
        camera, pose = sight.camera, np.eye(4)
        pose[:3, :3], pose[:3, 3] = camera.rotation, camera.position
        first, second, third, fourth = ((float(a), float(b), float(c), float(d)) for a, b, c, d in pose)
        return cls(
            before=_image(sight.before),
            item=_image(sight.item),
            plate=None if sight.plate is None else _image(sight.plate),
            intrinsics=(camera.fx, camera.fy, camera.cx, camera.cy),
            pose=(first, second, third, fourth),
            item_material=_numbers(sight.item_material),
            scene_material=_numbers(sight.scene_material),
            name=sight.name,
            instance=instance,
        )

    def sight(self) -> Sight:
        """Return what is seen.

        Raises:
            ModelError: The worker sent a camera or a material that is none.
        """
        pose = np.array(self.pose)
        try:
            return Sight(
                before=self.before.values(),
                item=self.item.values(),
                plate=None if self.plate is None else self.plate.values(),
                camera=Camera(*self.intrinsics, rotation=pose[:3, :3], position=pose[:3, 3]),
                item_material=Material(*self.item_material),
                scene_material=Material(*self.scene_material),
                name=self.name,
            )
        except RequestError as error:
            raise ModelError(f"world/{self.instance}: {error}") from None


class ExecuteRequest(Request):
    """Asks to place the table's item, and what a camera sees then. The same request always leads to the same."""

    table: Table
    action: tuple[float, float] = Field(description="Where the item's centre shall be, x and y [m].")


class ExecuteReply(Reply):
    """The depth image after the action."""

    after: Array = Field(description="Plate, fries and item (h, w) [m], 0 where there is none.")
    instance: str


def _image(depth: Floats) -> Array:
    return Array.of(np.asarray(depth, dtype=np.float32))


def _numbers(material: Material) -> Numbers3:
    return material.density, material.youngs_modulus, material.poisson_ratio
