import numpy as np
import pytest
from depth_scene import FRIES, SIZE, THICKNESS, camera, look, surface

from common.domain.bodies import Material
from common.domain.camera import Camera
from common.domain.errors import RequestError
from common.domain.grid import Grid
from common.domain.world import Sight
from pipelines.data.depth import heightmap_from_depth
from pipelines.data.depth_case import make_case

GRID = Grid(84, 84, 0.003)
PLATE = np.hypot(GRID.x[None, :], GRID.y[:, None]) < 0.120
BEEF, POTATO = Material(1050, 3e4, 0.4), Material(550, 1e6, 0.3)
EYE = camera()


@pytest.fixture(scope="module")
def seen():
    """Return a scene and its depth image."""
    scene = surface(fries=FRIES, item=(0.03, -0.02))
    return scene, look(scene, EYE)


def errors(scene, depth, eye=EYE):
    return (heightmap_from_depth(depth, eye, GRID).heights - scene.means(GRID))[PLATE]


def rms(values):
    return float(np.sqrt((values**2).mean()))


def test_a_scene_seen_by_a_camera_comes_back_as_its_mean_heights(seen):
    found = errors(*seen)
    assert np.median(np.abs(found)) < 0.0001
    assert rms(found) < 0.0007


@pytest.mark.parametrize("tilt", [0.0, 0.2])
def test_another_view_shows_the_same_heights(tilt):
    scene, eye = surface(fries=FRIES), camera(tilt=tilt)
    assert rms(errors(scene, look(scene, eye), eye)) < 0.0007


def test_noise_dropouts_and_whole_millimetres_cost_little(seen):
    scene, depth = seen
    rng = np.random.default_rng(0)
    noisy = np.rint((depth + rng.normal(0, 0.001, SIZE)) * 1e3) / 1e3
    noisy[rng.random(SIZE) < 0.05] = 0
    noisy[rng.random(SIZE) < 0.01] = np.nan
    assert rms(errors(scene, noisy)) < 0.0011


def test_an_edge_that_bleeds_is_dropped(seen):
    scene, depth = seen
    bled = depth.copy()
    jump = np.abs(np.diff(depth, axis=1)) > 0.01
    bled[:, 1:][jump] = (depth[:, 1:] + depth[:, :-1])[jump] / 2
    assert jump.sum() > 50
    assert rms(errors(scene, bled)) < rms(errors(scene, depth)) + 0.0002


def test_what_hides_behind_an_item_is_taken_for_the_plate_that_it_stands_on():
    eye = camera(tilt=0.6)
    scene = surface(item=(0.0, 0.0))
    found = heightmap_from_depth(look(scene, eye), eye, GRID)
    behind = (np.abs(GRID.x)[None, :] < 0.03) & (GRID.y[:, None] > 0.037) & (GRID.y[:, None] < 0.05)
    assert (~found.is_measured[behind]).any()
    assert np.abs(found.heights[behind]).max() < 0.001


def test_a_hole_in_the_image_is_filled(seen):
    scene, depth = seen
    holed = depth.copy()
    holed[150:160, 120:140] = 0
    assert rms(errors(scene, holed)) < 0.002


def test_a_trial_becomes_a_case_with_item_scene_and_target():
    item, scene = surface(item=(0.021, -0.013)), surface(fries=FRIES)
    after = surface(fries=FRIES, item=(0.03, -0.02))
    before, placed, alone = (look(found, EYE) for found in (scene, after, item))
    case = make_case("tray", Sight(before, alone, None, EYE, BEEF, POTATO), placed, (0.03, -0.02), grid=GRID)
    inside = np.hypot(GRID.x[None, :] / 0.05, GRID.y[:, None] / 0.035)
    heights = case.state.item.heights
    assert np.abs(heights[inside < 0.9] - THICKNESS).max() < 0.001
    assert (heights[inside > 1.15] == 0).all()
    assert (case.state.item.materials[1][inside < 0.9] == np.float32(3e4)).all()
    fries = (scene.means(GRID) - surface().means(GRID)) > 0.008
    found = case.state.scene.materials[0] > 0
    assert (found & fries).sum() > 0.95 * fries.sum()
    assert (found[PLATE] & ~(scene.means(GRID) - surface().means(GRID) > 0.001)[PLATE]).sum() == 0
    assert rms((case.target - after.means(GRID))[PLATE]) < 0.0007
    assert case.reference_action == (0.03, -0.02)


def test_an_image_of_the_empty_plate_replaces_the_default_one():
    alone, empty = look(surface(item=(0.0, 0.0)), EYE), look(surface(), EYE)
    with_plate = make_case("a", Sight(empty, alone, empty, EYE, BEEF, POTATO), alone, None, grid=GRID)
    without = make_case("a", Sight(empty, alone, None, EYE, BEEF, POTATO), alone, None, grid=GRID)
    assert np.abs(with_plate.state.item.heights - without.state.item.heights).mean() < 0.0003
    assert not with_plate.state.scene.materials.any()
    assert with_plate.reference_action is None


def test_an_item_image_without_an_item_is_refused():
    empty = look(surface(), EYE)
    with pytest.raises(RequestError, match="expected something that rises above the plate"):
        make_case("a", Sight(empty, empty, None, EYE, BEEF, POTATO), empty, None, grid=GRID)


@pytest.mark.parametrize(
    ("depth", "message"),
    [
        (np.zeros(SIZE), "at least 60% of the grid's cells in the image, got 0%"),
        (np.full(SIZE, 600.0), "check intrinsics, pose and the unit of the depths"),
        (np.zeros((2, 5)), "expected an image"),
        (np.zeros((4, 4, 3)), "expected an image"),
    ],
)
def test_an_image_that_does_not_show_the_grid_is_refused(depth, message):
    with pytest.raises(RequestError, match=message):
        heightmap_from_depth(depth, EYE, GRID)


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"fx": 0.0}, "focal lengths above 0"),
        ({"cx": np.nan}, "finite numbers"),
        ({"rotation": np.diag([1.0, 1.0, -1.0])}, "expected a rotation"),
        ({"rotation": 2 * np.eye(3)}, "expected a rotation"),
        ({"position": np.zeros(2)}, "a finite position"),
    ],
)
def test_a_camera_that_cannot_be_is_refused(changes, message):
    values = {"fx": 400.0, "fy": 400.0, "cx": 1.0, "cy": 1.0, "rotation": np.eye(3), "position": np.zeros(3)}
    with pytest.raises(RequestError, match=message):
        Camera(**(values | changes))
