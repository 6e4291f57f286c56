"""Whether a state is like those of the training data: its grid, its plate, its materials and sizes."""

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from common.domain.grid import Floats, Grid
from common.domain.scene import RIGID_MODULUS, State

RING = 0.003
"""Width of the rings in which the bare plate is compared [m]."""

PLATE_TOLERANCE = 0.002
"""A cell of bare plate is another plate's where it is this far from the height of its ring [m]."""

PLATE_MARGIN = 0.03
"""Share of such cells beyond the largest in the training data that makes a plate another one [-]."""

RANGE_MARGIN = 0.05
"""Share of a quantity's range by which it may lie outside of it [-]."""


@dataclass(frozen=True)
class Familiarity:
    """What the training data covers.

    Attributes:
        grid: The only grid.
        plate: Median height of the bare plate in rings around the centre, `RING` wide ``(R,)`` [m].
        plate_misfit: Largest share of bare cells that are off the plate by more than `PLATE_TOLERANCE`.
        ranges: Smallest and largest value of each quantity of `quantities`.
        reach_m: Largest distance of an action from the plate's centre [m].
    """

    grid: Grid
    plate: tuple[float, ...]
    plate_misfit: float
    ranges: dict[str, tuple[float, float]]
    reach_m: float

    @classmethod
    def of(
        cls,
        grid: Grid,
        heights: Floats,
        materials: Floats,
        item_heights: Floats,
        item_materials: Floats,
        *,
        actions: Floats,
    ) -> "Familiarity":
        """Return what states and actions cover: scenes ``(S, H, W)``, ``(S, 3, H, W)``, items alike, ``(N, 2)`` [m]."""
        rings, bare = _rings(grid), _is_bare(materials)
        seen = {ring: heights[:, rings == ring][bare[:, rings == ring]] for ring in range(int(rings.max()) + 1)}
        known = {ring: float(np.median(values)) for ring, values in seen.items() if values.size}
        plate = np.interp(np.arange(len(seen)), list(known), list(known.values()))
        misfits = [_misfit(one, is_bare, plate[rings]) for one, is_bare in zip(heights, bare, strict=True)]
        drawn = [
            quantities(*arrays, cell=grid.cell)
            for arrays in zip(heights, materials, item_heights, item_materials, strict=True)
        ]
        names = sorted({name for one in drawn for name in one})
        values = {name: [one[name] for one in drawn if name in one] for name in names}
        ranges = {
            name: (min(low for low, _ in pairs), max(high for _, high in pairs)) for name, pairs in values.items()
        }
        reach_m = float(np.hypot(actions[:, 0], actions[:, 1]).max())
        return cls(grid, tuple(plate.tolist()), max(misfits), ranges, reach_m)

    def extended(
        self,
        heights: Floats,
        materials: Floats,
        item_heights: Floats,
        item_materials: Floats,
        *,
        actions: Floats,
    ) -> "Familiarity":
        """Return what is covered together with further states and actions, given as to `of`.

        The known plate stays; the share of bare cells that may be off it grows to the largest of the new scenes, where
        a camera's noise and holes are. A range grows to the new values and takes in all that lies between.
        """
        added = Familiarity.of(self.grid, heights, materials, item_heights, item_materials, actions=actions)
        expected = np.array(self.plate)[_rings(self.grid)]
        misfits = [_misfit(one, bare, expected) for one, bare in zip(heights, _is_bare(materials), strict=True)]
        ranges = dict(self.ranges)
        for name, (low, high) in added.ranges.items():
            least, most = ranges.get(name, (low, high))
            ranges[name] = min(least, low), max(most, high)
        misfit, reach_m = max(self.plate_misfit, *misfits), max(self.reach_m, added.reach_m)
        return Familiarity(self.grid, self.plate, misfit, ranges, reach_m)

    def complaint(self, state: State) -> str:
        """Return in what a state differs from all that is covered, empty if in nothing."""
        if state.grid != self.grid:
            return f"grid: expected {self.grid}, got {state.grid}"
        scene, item = state.scene, state.item
        expected = np.array(self.plate)[_rings(self.grid)]
        misfit = _misfit(scene.heights, _is_bare(scene.materials), expected)
        if misfit > self.plate_misfit + PLATE_MARGIN:
            return (
                f"plate: expected {1 - self.plate_misfit - PLATE_MARGIN:.0%} of its bare cells within "
                f"{1e3 * PLATE_TOLERANCE:g} mm of the known plate, got {1 - misfit:.0%}"
            )
        found = quantities(scene.heights, scene.materials, item.heights, item.materials, cell=self.grid.cell)
        for name, (low, high) in found.items():
            if name not in self.ranges:
                return f"{name}: expected none, got {low:.4g} to {high:.4g}"
            least, most = self.ranges[name]
            margin = RANGE_MARGIN * (most - least) + 1e-6 * max(abs(least), abs(most))
            if low < least - margin or high > most + margin:
                return f"{name}: expected {least:.4g} to {most:.4g}, got {low:.4g} to {high:.4g}"
        return ""

    def reaches(self, actions: Floats) -> NDArray[np.bool_]:
        """Return which actions ``(B, 2)`` [m] are as near to the plate's centre as those that are covered."""
        return np.hypot(actions[:, 0], actions[:, 1]) <= (1 + RANGE_MARGIN) * self.reach_m

    def statistics(self) -> dict[str, Any]:
        """Return everything but the grid, ready for JSON."""
        return {
            "plate": list(self.plate),
            "plate_misfit": self.plate_misfit,
            "ranges": self.ranges,
            "reach_m": self.reach_m,
        }

    @classmethod
    def from_statistics(cls, grid: Grid, statistics: dict[str, Any]) -> "Familiarity":
        """Return what `statistics` told of.

        Raises:
            KeyError, TypeError, ValueError: It is something else.
        """
        plate = tuple(float(height) for height in statistics["plate"])
        if len(plate) != int(_rings(grid).max()) + 1:
            raise ValueError(f"expected a plate of {int(_rings(grid).max()) + 1} rings, got {len(plate)}")
        ranges = {str(name): (float(low), float(high)) for name, (low, high) in statistics["ranges"].items()}
        return cls(grid, plate, float(statistics["plate_misfit"]), ranges, float(statistics["reach_m"]))


def quantities(
    heights: Floats, materials: Floats, item_heights: Floats, item_materials: Floats, *, cell: float
) -> dict[str, tuple[float, float]]:
    """Return smallest and largest value of what networks cannot extrapolate in, by name with its unit."""
    found = {
        **_materials("fry", materials),
        **_materials("rigid item" if _is_rigid(item_materials) else "soft item", item_materials),
        "item's thickness [m]": 2 * (float(item_heights.max()),),
        "item's area [m2]": 2 * (float((item_heights > 0).sum()) * cell**2,),
        "fries' area [m2]": 2 * (float((materials[0] > 0).sum()) * cell**2,),
        "scene's height [m]": 2 * (float(heights.max()),),
    }
    return {name: (pair[0], pair[1]) for name, pair in found.items()}


def _materials(thing: str, materials: Floats) -> dict[str, tuple[float, ...]]:
    there = materials[0] > 0
    if not there.any():
        return {}
    density, modulus, poisson = (channel[there] for channel in materials)
    logarithm = np.log10(np.maximum(modulus, 1e-3))
    return {
        f"{thing}'s density [kg/m3]": (float(density.min()), float(density.max())),
        f"{thing}'s log10 of Young's modulus [Pa]": (float(logarithm.min()), float(logarithm.max())),
        f"{thing}'s Poisson's ratio": (float(poisson.min()), float(poisson.max())),
    }


def _is_rigid(materials: Floats) -> bool:
    return bool((materials[1][materials[1] > 0] >= RIGID_MODULUS).all())


def _rings(grid: Grid) -> NDArray[np.int64]:
    return np.rint(np.hypot(grid.x[None, :], grid.y[:, None]) / RING).astype(np.int64)


def _is_bare(materials: Floats) -> NDArray[np.bool_]:
    """Return where there is neither a fry nor one in a neighbouring cell, from ``(..., 3, H, W)``."""
    padded = np.pad(materials[..., 0, :, :] > 0, [(0, 0)] * (materials.ndim - 3) + [(1, 1), (1, 1)])
    rows, columns = materials.shape[-2:]
    covered = np.zeros((*materials.shape[:-3], rows, columns), dtype=bool)
    for row in range(3):
        for column in range(3):
            covered |= padded[..., row : row + rows, column : column + columns]
    return ~covered


def _misfit(heights: Floats, is_bare: NDArray[np.bool_], plate: Floats) -> float:
    return float((np.abs(heights - plate)[is_bare] > PLATE_TOLERANCE).mean()) if is_bare.any() else 0.0
