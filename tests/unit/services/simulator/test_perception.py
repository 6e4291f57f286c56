import dataclasses

import numpy as np
import pytest

from common.domain.bodies import Bodies, Box, Material, Plate
from common.domain.errors import ModelError
from common.domain.grid import Grid
from common.domain.scene import Scene
from common.tasks.plating import dinner_plate, render_scene
from services.simulator.perception import find_bodies
from services.simulator.perception_boxes import axes, soft_tops

POTATO = Material(550, 1e6, 0.3)
SIZE = (0.060, 0.010, 0.010)


def a_fry(x, y, z, yaw, *, pitch=0.0, size=SIZE):
    """A fry whose centre is at (x, y, z) [m], turned by yaw and raised by pitch at its far end [rad]."""
    half_yaw, half_pitch = yaw / 2, -pitch / 2
    orientation = np.array(
        [
            -np.sin(half_yaw) * np.sin(half_pitch),
            np.cos(half_yaw) * np.sin(half_pitch),
            np.sin(half_yaw) * np.cos(half_pitch),
            np.cos(half_yaw) * np.cos(half_pitch),
        ]
    )
    return Box(np.array(size), np.array([x, y, z]), orientation, POTATO)


def seen(*boxes, grid=None, plate=None):
    """Draw boxes on a plate and forget which they were."""
    scene = render_scene(grid or Grid(), Bodies(plate or dinner_plate(), boxes))
    return dataclasses.replace(scene, bodies=None)


def assert_found(found, true, *, metres=1e-3, degrees=3.0):
    assert len(found.boxes) == len(true)
    for box in true:
        nearest = min(found.boxes, key=lambda other: np.linalg.norm(other.position - box.position))
        assert np.linalg.norm(nearest.position - box.position) < metres
        cosine = abs(nearest.rotation[:, 0] @ box.rotation[:, 0])
        assert np.degrees(np.arccos(min(cosine, 1.0))) < degrees


@pytest.mark.parametrize("yaw", np.radians([17, 35, 50, 70, 110, 160]))
@pytest.mark.parametrize("centre", [(0.0, 0.0), (0.0312, -0.0287)])
def test_a_single_fry_is_found_within_a_millimetre_and_3_degrees(yaw, centre):
    fry = a_fry(*centre, 0.005, yaw)
    found = find_bodies(seen(fry))
    assert_found(found, [fry])
    assert found.boxes[0].size == pytest.approx(fry.size, abs=2e-3)


@pytest.mark.parametrize("yaw", np.radians([0, 45, 90, 135]))
def test_a_fry_along_the_grid_whose_ends_only_two_columns_show_is_found_within_half_a_cell(yaw):
    fry = a_fry(0.0312, -0.0287, 0.005, yaw)
    assert_found(find_bodies(seen(fry)), [fry], metres=1.5e-3)


def test_a_fry_that_leans_is_found_with_its_slope():
    fry = a_fry(0.02, 0.01, 0.012, 0.6, pitch=0.25)
    assert_found(find_bodies(seen(fry)), [fry])


@pytest.mark.parametrize("angle", np.radians([35, 60, 90]))
def test_two_crossed_fries_are_both_found(angle):
    lower, upper = a_fry(0.01, 0, 0.005, 0.3), a_fry(0.012, 0.002, 0.015, 0.3 + angle)
    assert_found(find_bodies(seen(lower, upper)), [lower, upper], metres=1.5e-3)


def test_fries_side_by_side_are_told_apart():
    first, second = a_fry(0, 0, 0.005, 0.4), a_fry(-0.0105 * np.sin(0.4), 0.0105 * np.cos(0.4), 0.005, 0.4)
    assert_found(find_bodies(seen(first, second)), [first, second], metres=1.5e-3)


@pytest.mark.parametrize("grid", [Grid(64, 64, 0.004), Grid(140, 150, 0.002)])
def test_fries_are_found_on_other_grids(grid):
    lower, upper = a_fry(0.01, -0.02, 0.005, 0.3), a_fry(0.012, -0.018, 0.015, 1.5)
    assert_found(find_bodies(seen(lower, upper, grid=grid)), [lower, upper], metres=1.5e-3)


def test_fries_of_another_size_are_found():
    fry = a_fry(0, 0.02, 0.006, 1.0, size=(0.072, 0.012, 0.012))
    found = find_bodies(seen(fry))
    assert_found(found, [fry])
    assert found.boxes[0].size == pytest.approx(fry.size, abs=1.5e-3)


def test_material_comes_from_the_masks():
    found = find_bodies(seen(a_fry(0, 0, 0.005, 0.3))).boxes[0].material
    assert (found.density, found.youngs_modulus) == (550, 1e6)
    assert found.poisson_ratio == pytest.approx(0.3)


def test_noise_of_half_a_millimetre_does_not_change_what_is_found():
    fries = [a_fry(0.01, 0, 0.005, 0.3), a_fry(0.012, 0.002, 0.015, 1.5), a_fry(-0.05, -0.03, 0.005, 2.0)]
    scene = seen(*fries)
    noise = np.random.default_rng(0).normal(0, 5e-4, scene.heights.shape)
    found = find_bodies(Scene(scene.grid, scene.heights + noise, scene.materials))
    assert_found(found, fries, metres=2e-3)


def test_an_empty_plate_has_a_plate_and_no_fries():
    found = find_bodies(seen())
    assert found.boxes == ()
    assert np.abs(found.plate.heightmap(Grid()) - dinner_plate().heightmap(Grid())).mean() < 1e-5


def test_another_plate_is_found_and_continued_under_a_heap_at_its_centre():
    bowl = Plate(np.array([0, 0.05, 0.11, 0.115, 0.2]), np.array([0.004, 0.004, 0.03, 0.0, 0.0]))
    fries = [a_fry(0, 0.011 * step, 0.009, 0.0) for step in (-1, 0, 1)]
    found = find_bodies(seen(*fries, plate=bowl))
    inner = np.linspace(0, 0.1, 60)
    assert np.abs(found.plate.height(inner) - bowl.height(inner)).max() < 2e-4


def test_equal_scenes_give_equal_bodies():
    scene = seen(a_fry(0.01, 0, 0.005, 0.3), a_fry(0.012, 0.002, 0.015, 1.5))
    first, second = (np.array([box.position for box in find_bodies(scene).boxes]) for _ in range(2))
    assert (first == second).all()


def test_a_plate_that_is_not_round_is_refused():
    grid = Grid()
    heights = np.where(np.abs(grid.x[None, :]) < 0.05, 0.02, 0.0) + 0 * grid.y[:, None]
    with pytest.raises(ModelError, match=r"surface of revolution about the grid's centre within 2 mm, got \d+%"):
        find_bodies(Scene(grid, heights, np.zeros((3, *grid.shape))))


def test_a_scene_without_bare_plate_is_refused():
    grid = Grid(8, 8)
    with pytest.raises(ModelError, match="expected at least 50 cells of bare plate"):
        find_bodies(Scene(grid, np.zeros(grid.shape), np.full((3, *grid.shape), 0.3)))


def test_a_mask_without_anything_on_the_plate_gives_no_fry():
    scene = seen()
    materials = np.zeros((3, *scene.grid.shape))
    materials[:, 40:44, 40:60] = 0.3
    assert find_bodies(Scene(scene.grid, scene.heights, materials)).boxes == ()


def test_soft_tops_are_the_real_tops_away_from_the_edges():
    fry = a_fry(0.01, 0.02, 0.02, 0.7, pitch=0.3)
    up = fry.rotation[:, 2] * 0.005
    row = np.array([*(fry.position + up), 0.7, np.tan(0.3), 0.0, 0.06, 0.01])
    along, across = np.meshgrid(np.linspace(-0.025, 0.025, 11), np.linspace(-0.002, 0.002, 5))
    points = row[:2] + np.stack([along.ravel(), across.ravel()], axis=1) @ axes(row)[:2, :2]
    soft = soft_tops(row, points, np.zeros(len(points)), 0.003)
    assert soft == pytest.approx(fry.top(*points.T), abs=1e-5)


def test_axes_are_right_handed_and_orthonormal_with_the_slopes_asked_for():
    rows = np.random.default_rng(0).normal(size=(50, 8)) * 0.3
    frames = axes(rows)
    assert frames @ np.swapaxes(frames, -1, -2) == pytest.approx(np.broadcast_to(np.eye(3), frames.shape), abs=1e-12)
    assert np.linalg.det(frames) == pytest.approx(np.ones(50))
    assert frames[:, 0, 2] / np.hypot(frames[:, 0, 0], frames[:, 0, 1]) == pytest.approx(rows[:, 4])


def test_a_flat_fry_on_another_is_as_thick_as_the_gap_it_fills():
    lower, upper = a_fry(0.01, 0, 0.005, 0.3), a_fry(0.012, 0.002, 0.01455, 1.5, size=(0.060, 0.010, 0.0091))
    found = find_bodies(seen(lower, upper))
    assert_found(found, [lower, upper], metres=1.5e-3)
    assert sorted(box.size[2] for box in found.boxes) == pytest.approx([0.0091, 0.010], abs=2e-4)
