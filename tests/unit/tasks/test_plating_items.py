import numpy as np
import pytest

from common.domain.bodies import Material
from common.domain.errors import RequestError
from common.domain.grid import Grid
from common.domain.scene import RIGID_MODULUS
from common.tasks.plating_items import RoundedRectangle, TwoLobes, Wavy, draw_item

MEAT = Material(1050, 5e4, 0.3)
OUTLINES = {
    "steak": RoundedRectangle(0.14, 0.09, 0.02),
    "ellipse": Wavy(0.14, 0.09),
    "irregular": Wavy(0.13, 0.09, (0.08, -0.07, 0.05), (0.3, 2.0, 4.0)),
    "t_bone": TwoLobes(0.14, 0.09, 0.35),
}


@pytest.mark.parametrize("outline", OUTLINES.values(), ids=OUTLINES)
@pytest.mark.parametrize("angle", [0.0, 0.7, 2.4])
def test_an_items_centre_of_area_is_the_grids_centre_at_any_orientation(outline, angle):
    grid = Grid(144, 144, 0.002)
    covered = draw_item(grid, outline, thickness=0.02, material=MEAT, angle=angle).outline
    x, y = np.meshgrid(grid.x, grid.y)
    assert abs(x[covered].mean()) < 5e-4
    assert abs(y[covered].mean()) < 5e-4


@pytest.mark.parametrize("outline", OUTLINES.values(), ids=OUTLINES)
def test_an_outline_stays_within_its_reach(outline):
    angle = np.linspace(0, 2 * np.pi, 361)
    for radius in (1.0001, 1.2, 2.0):
        reach = radius * outline.reach
        assert not outline.contains(reach * np.cos(angle), reach * np.sin(angle)).any()


def test_a_drawn_rectangle_and_a_drawn_ellipse_have_the_areas_of_their_formulas():
    grid = Grid(400, 400, 0.0005)
    rectangle = draw_item(grid, RoundedRectangle(0.14, 0.09, 0.02), thickness=0.02, material=MEAT, angle=0.3)
    ellipse = draw_item(grid, Wavy(0.14, 0.09), thickness=0.02, material=MEAT, angle=0.3)
    area = grid.cell**2
    assert rectangle.outline.sum() * area == pytest.approx(0.14 * 0.09 - (4 - np.pi) * 0.02**2, rel=1e-3)
    assert ellipse.outline.sum() * area == pytest.approx(np.pi / 4 * 0.14 * 0.09, rel=1e-3)


def test_turning_an_item_by_a_quarter_turns_its_heightmap():
    level = draw_item(Grid(), OUTLINES["t_bone"], thickness=0.02, material=MEAT, angle=0.0).outline
    turned = draw_item(Grid(), OUTLINES["t_bone"], thickness=0.02, material=MEAT, angle=np.pi / 2).outline
    assert (turned != np.rot90(level, -1)).sum() <= 4  # np.rot90 turns from rows to columns, y from columns to rows


def test_a_taper_changes_the_thickness_linearly_about_the_centre():
    item = draw_item(Grid(97, 97), Wavy(0.1, 0.1), thickness=0.02, material=MEAT, taper=(0.1, 0.0))
    assert item.heights[48, 48] == pytest.approx(0.02)
    assert item.heights[48, 48 + 10] == pytest.approx(0.02 * (1 + 0.1 * 0.03 / 0.05))
    assert item.heights[48, 48 - 10] == pytest.approx(0.02 * (1 - 0.1 * 0.03 / 0.05))


def test_masks_hold_the_material_inside_and_nothing_outside():
    item = draw_item(Grid(), Wavy(0.1, 0.08), thickness=0.02, material=Material(1050, RIGID_MODULUS, 0.3))
    assert item.is_rigid
    assert (item.materials[0][item.outline] == 1050).all()
    assert not item.materials[:, ~item.outline].any()


def test_an_item_that_does_not_fit_on_the_grid_is_refused():
    with pytest.raises(RequestError, match=r"expected an item that fits on a grid of 0\.096 x 0\.096 m"):
        draw_item(Grid(32, 32), OUTLINES["steak"], thickness=0.02, material=MEAT)
