"""Grids, scenes, items and states refuse what they cannot mean."""

import numpy as np
import pytest

from common.domain.bodies import Bodies, Box, Material, Plate
from common.domain.errors import RequestError
from common.domain.grid import Grid
from common.domain.scene import Item, Scene, State
from common.tasks.plating import dinner_plate, render_scene

GRID = Grid(20, 24, 0.01)
FRY = Box(
    np.array([0.06, 0.01, 0.01]), np.array([0.0, 0.0, 0.005]), np.array([0.0, 0.0, 0.0, 1.0]), Material(550, 1e6, 0.3)
)


def an_item(thickness: float = 0.02, modulus: float = 5e4) -> Item:
    heights = np.zeros(GRID.shape, np.float32)
    heights[8:12, 8:16] = thickness
    materials = np.zeros((3, *GRID.shape), np.float32)
    materials[:, 8:12, 8:16] = np.array([1050, modulus, 0.4])[:, None, None]
    return Item(heights, materials)


def a_scene() -> Scene:
    return render_scene(GRID, Bodies(dinner_plate(), (FRY,)))


def test_cell_centres_increase_and_are_symmetric_about_the_plates_centre():
    assert GRID.x[0] == pytest.approx(-0.115)
    assert GRID.y[-1] == pytest.approx(0.095)
    np.testing.assert_allclose(GRID.x, -GRID.x[::-1])


@pytest.mark.parametrize(
    ("rows", "columns", "cell"), [(1, 1, 0.003), (0, 96, 0.003), (96, 96, 0.0), (5000, 5000, 0.003)]
)
def test_a_senseless_grid_is_refused(rows: int, columns: int, cell: float):
    with pytest.raises(RequestError, match="expected"):
        Grid(rows, columns, cell)


@pytest.mark.parametrize("bad", [np.nan, np.inf, 2.0])
def test_heights_that_are_not_finite_or_not_of_a_table_top_are_refused(bad: float):
    heights = np.zeros(GRID.shape, np.float32)
    heights[3, 4] = bad
    with pytest.raises(RequestError, match=r"scene\.heights: expected"):
        Scene(GRID, heights, np.zeros((3, *GRID.shape), np.float32))


def test_shapes_must_be_the_grids():
    with pytest.raises(RequestError, match=r"expected shape \(20, 24\), got \(24, 20\)"):
        Scene(GRID, np.zeros((24, 20), np.float32), np.zeros((3, 20, 24), np.float32))


def test_an_item_needs_thickness_and_material():
    scene = a_scene()
    with pytest.raises(RequestError, match="some above 0"):
        State(scene, Item(np.zeros(GRID.shape, np.float32), np.zeros((3, *GRID.shape), np.float32)))
    with pytest.raises(RequestError, match="density and Young's modulus above 0"):
        State(scene, Item(an_item().heights, np.zeros((3, *GRID.shape), np.float32)))
    with pytest.raises(RequestError, match=r"Poisson's ratios below 0\.5"):
        State(scene, Item(an_item().heights, np.full((3, *GRID.shape), 0.6, np.float32)))


def test_an_item_is_rigid_only_if_it_is_stiff_everywhere():
    assert an_item(modulus=1e8).is_rigid
    assert not an_item(modulus=1e6).is_rigid


def test_the_digest_tells_states_apart_and_survives_a_copy():
    state = State(a_scene(), an_item())
    assert state.digest == State(a_scene(), an_item()).digest
    others = [
        State(a_scene(), an_item(thickness=0.021)),
        State(a_scene(), an_item(modulus=6e4)),
        State(Scene(GRID, a_scene().heights, a_scene().materials), an_item()),
        State(Scene(GRID, a_scene().heights, a_scene().materials, Bodies(None, (FRY,))), an_item()),
    ]
    assert len({state.digest, *(other.digest for other in others)}) == 5


def test_arrays_of_a_state_cannot_be_written_into():
    state = State(a_scene(), an_item())
    with pytest.raises(ValueError, match="read-only"):
        state.scene.heights[0, 0] = 1


def test_a_plate_needs_increasing_radii_from_zero():
    with pytest.raises(RequestError, match="start at 0 and increase"):
        Plate(np.array([0.0, 0.1, 0.1]), np.zeros(3))


def test_a_box_needs_a_unit_quaternion():
    with pytest.raises(RequestError, match="unit quaternion"):
        Box(FRY.size, FRY.position, np.array([0, 0, 0, 2.0]), FRY.material)


def test_a_box_is_drawn_at_its_height_with_rounded_edges():
    top = FRY.top(np.array([0.0, 0.0285, 0.0299, 0.031]), np.zeros(4))
    assert top[0] == pytest.approx(0.01, abs=1e-6)
    assert top[1] == pytest.approx(0.01, abs=1e-6)
    inside_rounding = 0.0299 - 0.0285
    assert top[2] == pytest.approx(0.0085 + np.sqrt(0.0015**2 - inside_rounding**2), abs=5e-5)
    assert top[3] == -np.inf


def test_a_tilted_box_is_drawn_along_its_slope():
    angle = 0.3
    tilted = Box(FRY.size, np.array([0, 0, 0.02]), np.array([0, np.sin(angle / 2), 0, np.cos(angle / 2)]), FRY.material)
    top = tilted.top(np.array([-0.01, 0.0, 0.01]), np.zeros(3))
    np.testing.assert_allclose(np.diff(top), -0.01 * np.tan(angle), atol=1e-6)
    assert top[1] == pytest.approx(0.02 + 0.005 / np.cos(angle), abs=1e-6)


def test_a_rebuilt_box_keeps_every_bit_of_its_orientation():
    rng = np.random.default_rng(0)
    for _ in range(200):
        box = Box(FRY.size, FRY.position, (q := rng.normal(size=4)) / np.linalg.norm(q), FRY.material)
        again = Box(box.size, box.position, box.orientation, box.material)
        np.testing.assert_array_equal(again.orientation, box.orientation)
