"""What a robot can do in the world: look at a table, place the item on it, look again."""

from abc import ABC, abstractmethod
from dataclasses import dataclass

from common.domain.bodies import Material
from common.domain.camera import Camera
from common.domain.grid import Floats


@dataclass(frozen=True)
class Sight:
    """What a depth camera sees of a table before anything is placed. Depths of 0 or NaN: none.

    Attributes:
        before: Plate and food ``(h, w)`` [m].
        item: The item alone on the empty plate, its whole outline on the flat ``(h, w)`` [m].
        plate: The empty plate ``(h, w)`` [m]; None: nobody took an image of it.
        camera: The camera as it was calibrated.
        item_material: What the item is made of.
        scene_material: What lies on the plate.
        name: What the item is called.
    """

    before: Floats
    item: Floats
    plate: Floats | None
    camera: Camera
    item_material: Material
    scene_material: Material
    name: str = ""


class World(ABC):
    """Tables by number, each with a plate, food and an item to place.

    Attributes:
        version: Version of everything that it looks like.
    """

    version: str

    @abstractmethod
    def look(self, table: int) -> Sight:
        """Return what is seen of a table.

        Raises:
            RequestError: There is no such table.
            ModelError: It could not be laid.
        """

    @abstractmethod
    def execute(self, table: int, action: tuple[float, float]) -> Floats:
        """Place the table's item, its centre at ``(x, y)`` [m], and return the depth image of what came to rest [m].

        Raises:
            RequestError: There is no such table, or the action is off the plate.
            ModelError: Nothing came to rest.
        """
