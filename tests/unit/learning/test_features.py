"""Channels, windows and symmetries."""

import numpy as np
import pytest
import torch

from common.domain.grid import Grid
from common.domain.heightmap import shift
from common.learning.features import (
    SYMMETRIES,
    cells,
    centred_first,
    channels,
    item_first,
    transform,
    transform_actions,
    whole_first,
    window,
)

GRID = Grid(20, 24, 0.003)
RNG = np.random.default_rng(3)
SCENE = RNG.normal(size=GRID.shape).astype(np.float32)
ITEM = np.zeros(GRID.shape, np.float32)
ITEM[7:13, 8:15] = RNG.uniform(0.5, 1, (6, 7))
ACTIONS = np.array([[0.0, 0.0], [0.0101, -0.0077], [-0.0150, 0.0060], [0.0209, 0.0169]])


def of(image: np.ndarray) -> torch.Tensor:
    return torch.from_numpy(image.astype(np.float32))[None, None]


def test_an_items_window_is_the_shifted_item_seen_through_the_scenes_window():
    first = whole_first(ACTIONS, GRID, 10)
    found = window(of(ITEM), torch.from_numpy(item_first(ACTIONS, GRID, first)), 10, outside="zero")
    for action, (column, row), seen in zip(ACTIONS, first.astype(int), found[:, 0].numpy(), strict=True):
        moved = np.pad(shift(ITEM, *(action / GRID.cell)), 10)
        np.testing.assert_allclose(seen, moved[row + 10 : row + 20, column + 10 : column + 20], atol=1e-6)


def test_a_window_on_whole_cells_is_a_slice_and_repeats_the_border():
    first = torch.tensor([[3.0, 5.0], [-2.0, 14.0]], dtype=torch.float64)
    found = window(of(SCENE), first, 8)[:, 0].numpy()
    np.testing.assert_array_equal(found[0], SCENE[5:13, 3:11])
    np.testing.assert_array_equal(found[1], np.pad(SCENE, 8, mode="edge")[22:30, 6:14])


def test_windows_of_many_images_are_those_of_each():
    images = torch.from_numpy(RNG.normal(size=(4, 2, *GRID.shape)).astype(np.float32))
    first = torch.from_numpy(centred_first(ACTIONS, GRID, 9))
    together = window(images, first, 9, outside="zero")
    alone = [window(images[k : k + 1], first[k : k + 1], 9, outside="zero") for k in range(4)]
    assert torch.equal(together, torch.cat(alone))


def test_a_centred_window_has_a_planes_value_at_the_action_in_its_middle():
    plane = GRID.x[None, :] + 2 * GRID.y[:, None]
    inner = ACTIONS[:3]
    found = window(of(plane), torch.from_numpy(centred_first(inner, GRID, 5)), 5)[:, 0, 2, 2].numpy()
    np.testing.assert_allclose(found, inner @ [1, 2], atol=1e-8)


def test_another_outside_is_refused():
    with pytest.raises(ValueError, match="edge or zero"):
        window(of(SCENE), torch.zeros(1, 2, dtype=torch.float64), 4, outside="mirror")


def test_materials_are_scaled_and_bare_plate_is_zero():
    materials = np.zeros((3, *GRID.shape), np.float32)
    materials[:, 4, 5] = 1050, 1e7, 0.4
    seen = channels(np.full(GRID.shape, 0.02, np.float32), materials).numpy()
    np.testing.assert_allclose(seen[:, 4, 5], [2, 1, 1.05, 1, 0.8], rtol=1e-6)
    assert (seen[1:, 0] == 0).all()


@pytest.mark.parametrize("symmetry", range(SYMMETRIES))
def test_symmetries_move_state_action_and_outcome_together(symmetry: int):
    grid = Grid(21, 21, 0.003)
    item = np.zeros(grid.shape, np.float32)
    item[9:13, 8:12] = RNG.uniform(0.5, 1, (4, 4))
    action = np.array([0.0071, -0.0113])
    outcome = of(shift(item, *(action / grid.cell)))
    turned = transform(of(item), symmetry)[0, 0].numpy()
    moved = transform_actions(action, symmetry)
    np.testing.assert_allclose(
        transform(outcome, symmetry)[0, 0].numpy(), shift(turned, *(moved / grid.cell)), atol=1e-6
    )


def test_all_symmetries_differ():
    images = [tuple(transform(torch.arange(9).reshape(3, 3), k).flatten().tolist()) for k in range(SYMMETRIES)]
    assert len(set(images)) == SYMMETRIES


def test_the_origin_lies_between_the_middle_cells():
    np.testing.assert_allclose(cells(np.zeros((1, 2)), GRID), [[11.5, 9.5]])
