"""Find the plate in a heightmap: a surface of revolution about the grid's centre, seen beside the fries."""

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import binary_dilation, median_filter

from common.domain.bodies import Plate
from common.domain.errors import ModelError
from common.domain.scene import Scene

FEWEST_CELLS = 50
TOLERANCE = 2e-3
"""How far a bare cell may lie from the surface of revolution [m]."""
OUTLIERS = 0.03
"""Share of the bare cells that may lie further away."""
SIMPLIFICATION = 3e-5
"""How far the polyline may lie from the smoothed heights [m]."""


def fit_plate(scene: Scene) -> Plate:
    """Fit the plate's profile to the bare cells, and extend it under the fries.

    Bare is a cell whose material mask and whose neighbours' masks are 0: a cell beside a fry shows some of it.

    The heights are sorted by radius, smoothed by a running median (which keeps walls steep and ignores outliers), and
    simplified to a polyline. Radii of which nothing is bare are interpolated; the centre is level.

    Raises:
        ModelError: Too little of the plate is bare, or the bare cells are not a surface of revolution.
    """
    bare = np.logical_not(binary_dilation(scene.materials[0] > 0, np.ones((3, 3))))
    if bare.sum() < FEWEST_CELLS:
        raise ModelError(f"expected at least {FEWEST_CELLS} cells of bare plate to find the plate, got {bare.sum()}")
    cell_radii = np.hypot(scene.grid.x[None, :], scene.grid.y[:, None])[bare]
    order = np.argsort(cell_radii, kind="stable")
    radii, heights = cell_radii[order], scene.heights[bare].astype(np.float64)[order]
    kept = np.unique(np.linspace(0, len(radii) - 1, 20_000).astype(int))
    sorted_radii, smooth = radii[kept], median_filter(heights[kept], size=9, mode="nearest")
    _check_revolution(radii, heights, sorted_radii, smooth, scene.grid.cell)
    first = np.concatenate([[True], np.diff(sorted_radii) > 1e-6])
    sorted_radii, smooth = sorted_radii[first], smooth[first]
    tolerance = SIMPLIFICATION
    while len(knots := _simplify(sorted_radii, smooth, tolerance)) > 500:
        tolerance *= 2
    profile_radii, profile_heights = sorted_radii[knots], smooth[knots]
    if profile_radii[0] > 0:
        profile_radii = np.concatenate([[0.0], profile_radii])
        profile_heights = np.concatenate([[smooth[0]], profile_heights])
    return Plate(profile_radii, profile_heights)


def _check_revolution(
    radii: NDArray[np.float64],
    heights: NDArray[np.float64],
    sorted_radii: NDArray[np.float64],
    smooth: NDArray[np.float64],
    cell: float,
) -> None:
    """Compare every bare cell with the lowest and highest smoothed height within half a cell of its radius."""
    fine = np.arange(0, radii[-1] + cell, cell / 4)
    profile = np.interp(fine, sorted_radii, smooth)
    window = np.lib.stride_tricks.sliding_window_view(np.pad(profile, 2, mode="edge"), 5)
    low = np.interp(radii, fine, window.min(axis=1)) - TOLERANCE
    high = np.interp(radii, fine, window.max(axis=1)) + TOLERANCE
    share = float(((heights < low) | (heights > high)).mean())
    if share > OUTLIERS:
        raise ModelError(
            "expected the bare cells to form a surface of revolution about the grid's centre within "
            f"{TOLERANCE * 1e3:g} mm, got {share:.0%} of them further away"
        )


def _simplify(x: NDArray[np.float64], y: NDArray[np.float64], tolerance: float) -> NDArray[np.int64]:
    """Return the indices of a polyline's points that keep it within ``tolerance`` in y (Douglas and Peucker)."""
    kept, spans = {0, len(x) - 1}, [(0, len(x) - 1)]
    while spans:
        first, last = spans.pop()
        if last - first < 2:
            continue
        inner = slice(first + 1, last)
        chord = y[first] + (y[last] - y[first]) * (x[inner] - x[first]) / (x[last] - x[first])
        error = np.abs(y[inner] - chord)
        worst = int(error.argmax())
        if error[worst] > tolerance:
            middle = first + 1 + worst
            kept.add(middle)
            spans += [(first, middle), (middle, last)]
    return np.array(sorted(kept), dtype=np.int64)
