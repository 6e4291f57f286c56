"""Bars under their own weight in CalculiX: large displacements, contact without friction with a rigid profile.

Needs the program ``ccx`` (``apt-get install calculix-ccx``). Quadratic hexahedra, integrated with 2 x 2 x 2 points; the
bar lies along x, and of its width only the half with y >= 0 is computed.
"""

import subprocess
import tempfile
from dataclasses import dataclass
from itertools import product
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

CORNERS = ((0, 0, 0), (2, 0, 0), (2, 2, 0), (0, 2, 0), (0, 0, 2), (2, 0, 2), (2, 2, 2), (0, 2, 2))
EDGES = ((0, 1), (1, 2), (2, 3), (3, 0), (4, 5), (5, 6), (6, 7), (7, 4), (0, 4), (1, 5), (2, 6), (3, 7))
NODES = [*CORNERS, *(tuple((np.array(CORNERS[a]) + CORNERS[b]) // 2) for a, b in EDGES)]
"""Lattice steps of a hexahedron's twenty nodes."""

CONTACT_STIFFNESS = 1e9
"""Pressure over depth [Pa/m]."""
OVERLAP = 1e-5
"""How deep the bar starts in the profile, or nothing would hold it in the first iteration [m]."""
SKIN = 2e-3
"""Thickness of the layer of solid elements whose upper side is the profile [m]."""


@dataclass(frozen=True)
class Bar:
    """A bar of one material: edges [m], Young's modulus [Pa], Poisson's ratio [-], density [kg/m3], gravity [m/s2]."""

    length: float
    width: float
    thickness: float
    youngs_modulus: float
    poisson_ratio: float
    density: float = 1050.0
    gravity: float = 9.81


@dataclass(frozen=True)
class Deformed:
    """A deformed bar.

    Attributes:
        top: The line along the middle of its upper side ``(K, 2)``, x and z [m].
        tip: Mean of the far end's nodes, x and z, less where they were ``(2,)`` [m].
    """

    top: NDArray[np.float64]
    tip: NDArray[np.float64]


def bend(bar: Bar, cells: tuple[int, int, int], *, start: str, profile: NDArray[np.float64] | None = None) -> Deformed:
    """Return the bar's equilibrium.

    Args:
        bar: Its length is half of a bar that is mirrored.
        cells: Hexahedra along, across half the width, and through the thickness.
        start: The end at x = 0: ``clamped`` or ``mirrored``.
        profile: Where the bar may rest ``(K, 2)``, x increasing, and z [m]; its underside starts at z = 0.
    """
    shape = 2 * np.array(cells) + 1
    lattice = np.stack(np.meshgrid(*map(np.arange, shape), indexing="ij"), axis=-1).reshape(-1, 3)
    points = lattice / (shape - 1) * [bar.length, bar.width / 2, bar.thickness]
    used = (lattice % 2).sum(axis=1) <= 1
    first = lattice == 0
    if profile is not None:
        points[:, 2] -= OVERLAP
    deck = [
        *_nodes("BAR", np.flatnonzero(used) + 1, points[used]),
        *_set("START", used & first[:, 0]),
        *_set("MIDDLE", used & first[:, 1]),
        "*ELEMENT, TYPE=C3D20R, ELSET=SOFT",
    ]
    number = np.arange(1, len(lattice) + 1).reshape(shape)
    for element, base in enumerate(product(*map(range, cells)), start=1):
        nodes = [str(number[tuple(2 * np.array(base) + step)]) for step in NODES]
        deck += [f"{element}, {', '.join(nodes[:10])},", ", ".join(nodes[10:])]
    deck += [
        *("*MATERIAL, NAME=MEAT", "*ELASTIC", f"{bar.youngs_modulus:.9g}, {bar.poisson_ratio:g}"),
        *("*DENSITY", f"{bar.density:g}", "*SOLID SECTION, ELSET=SOFT, MATERIAL=MEAT"),
        *("*BOUNDARY", "MIDDLE, 2, 2", "START, 1, 3" if start == "clamped" else "START, 1, 1"),
    ]
    if profile is not None:
        bottom = [i * cells[2] + 1 for i in range(cells[0] * cells[1])]
        deck += _ground(profile, bar.width, bottom, len(lattice) + 1, int(np.prod(cells)) + 1)
    deck += [
        *("*STEP, NLGEOM, INC=1000", "*STATIC", "0.02, 1.0, 1e-6, 0.05"),
        *("*DLOAD", f"SOFT, GRAV, {bar.gravity}, 0., 0., -1."),
        *("*NODE PRINT, NSET=BAR, FREQUENCY=100000", "U", "*END STEP"),
    ]
    moved = points + _run(deck, len(points))
    middle = used & first[:, 1] & (lattice[:, 2] == shape[2] - 1)
    end = used & (lattice[:, 0] == shape[0] - 1)
    return Deformed(moved[middle][:, [0, 2]], (moved - points)[end].mean(axis=0)[[0, 2]])


def _ground(profile: NDArray[np.float64], width: float, bottom: list[int], node: int, element: int) -> list[str]:
    """Return the deck's lines for a fixed layer under the profile, in contact with the elements ``bottom``."""
    slope = np.gradient(profile, axis=0)
    normal = np.stack([-slope[:, 1], slope[:, 0]], axis=1) / np.linalg.norm(slope, axis=1)[:, None]
    sides = -SKIN, width / 2 + SKIN
    points = np.array([(x, y, z) for layer in (profile - SKIN * normal, profile) for y in sides for x, z in layer])
    count = len(profile)
    deck = [*_nodes("FLOOR", np.arange(len(points)) + node, points), "*ELEMENT, TYPE=C3D8, ELSET=STIFF"]
    for i in range(count - 1):
        corners = [node + i + step for step in (0, 1, count + 1, count)]
        deck.append(", ".join(map(str, [element + i, *corners, *(corner + 2 * count for corner in corners)])))
    return [
        *deck,
        *("*MATERIAL, NAME=ROCK", "*ELASTIC", "1e9, 0.3", "*SOLID SECTION, ELSET=STIFF, MATERIAL=ROCK"),
        *("*BOUNDARY", "FLOOR, 1, 3"),
        *("*SURFACE, NAME=UNDERSIDE", *(f"{number}, S1" for number in bottom)),
        *("*SURFACE, NAME=PROFILE", *(f"{element + i}, S2" for i in range(count - 1))),
        *("*SURFACE INTERACTION, NAME=SLIDING", "*SURFACE BEHAVIOR, PRESSURE-OVERCLOSURE=LINEAR"),
        f"{CONTACT_STIFFNESS:g}",
        *("*CONTACT PAIR, INTERACTION=SLIDING, TYPE=SURFACE TO SURFACE", "UNDERSIDE, PROFILE"),
    ]


def _nodes(name: str, numbers: NDArray[np.intp], points: NDArray[np.float64]) -> list[str]:
    lines = [f"{number}, {x:.9g}, {y:.9g}, {z:.9g}" for number, (x, y, z) in zip(numbers, points, strict=True)]
    return [f"*NODE, NSET={name}", *lines]


def _set(name: str, members: NDArray[np.bool_]) -> list[str]:
    return [f"*NSET, NSET={name}", *(f"{index + 1}," for index in np.flatnonzero(members))]


def _run(deck: list[str], count: int) -> NDArray[np.float64]:
    """Return the displacements at the whole load ``(count, 3)`` [m].

    Raises:
        RuntimeError: The program did not get there.
    """
    with tempfile.TemporaryDirectory() as folder:
        Path(folder, "bar.inp").write_text("\n".join(deck) + "\n")
        log = subprocess.run(["ccx", "-i", "bar"], cwd=folder, capture_output=True, text=True, check=False).stdout
        result = Path(folder, "bar.dat").read_text() if Path(folder, "bar.dat").exists() else ""
    title, *rows = result.split("displacements")[-1].strip().splitlines()
    if "0.1000000E+01" not in title:
        raise RuntimeError(f"expected displacements at the whole load, got {title!r}; {log[-500:]}")
    displacements = np.zeros((count, 3))
    for number, *values in (row.split() for row in rows if row.strip()):
        displacements[int(number) - 1] = [float(value) for value in values]
    return displacements
