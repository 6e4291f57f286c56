"""Materials of what is seen from above."""

from collections.abc import Callable

import numpy as np

from common.domain.bodies import Box
from common.domain.scene import Item, State
from common.tasks.plating import dinner_plate
from services.simulator.masks import boxes_after, materials_after
from services.simulator.model import SimulatorModel
from services.simulator.settle import settle_boxes


def test_the_topmost_thing_gives_each_cell_its_material(
    slab: Callable[..., Item], state_of: Callable[..., State], fry: Callable[..., Box]
) -> None:
    boxes = settle_boxes(dinner_plate(), [fry(0.06, 0, 0.006, np.pi / 2)])
    item = slab(20, 10, youngs_modulus=1e6)
    bone = item.outline & (np.arange(64) < 28)[None, :]
    materials = item.materials.copy()
    materials[1][bone] = 5e7
    state = state_of(Item(item.heights, materials), boxes)
    placement = SimulatorModel().placement(state)
    placed = placement.run(np.array([[-0.006, 0.009]]))
    seen = materials_after(placement, placed)
    expected = np.array(state.scene.materials)
    expected[:, 30:40, 20:40] = state.item.materials[:, 27:37, 22:42]
    assert (seen[1][30:40, 20:40] == expected[1][30:40, 20:40]).mean() > 0.99
    assert np.mean(seen == expected) > 0.99
    assert (seen[0][:, 60:] == 0).all()


def test_a_pushed_box_is_where_the_placement_left_it(
    slab: Callable[..., Item], state_of: Callable[..., State], fry: Callable[..., Box]
) -> None:
    boxes = settle_boxes(dinner_plate(), [fry(0.0, 0, 0.006, np.pi / 2), fry(0.0, 0.0, 0.02, 0.3)])
    placement = SimulatorModel().placement(state_of(slab(youngs_modulus=1e9), boxes))
    placed = placement.run(np.array([[0.01, 0.0]]))
    after = boxes_after(placement, placed)
    assert [box.size.tolist() for box in after] == [box.size.tolist() for box in boxes]
    assert np.allclose([box.position for box in after], placed.outcome.positions[0, 1:])
