"""Cases as compressed ``.npz`` files."""

import json
import os
import zipfile
import zlib
from collections.abc import Callable, Mapping
from io import BytesIO
from pathlib import Path
from typing import Any, TypeVar

import numpy as np
from numpy.typing import NDArray

from common.domain.bodies import Bodies, Box, Material, Plate
from common.domain.case import Case
from common.domain.errors import RequestError
from common.domain.grid import Grid
from common.domain.scene import Item, Scene, State

T = TypeVar("T")

FORMAT = "frugal-case-1"
DEFAULT_TASK = "plating"
BROKEN = (OSError, ValueError, TypeError, EOFError, RuntimeError, zipfile.BadZipFile, zlib.error)
"""What reading an archive raises that a disk or a copy has damaged."""


def write_case(path: Path, case: Case) -> None:
    """Write a case; the file appears whole or not at all, and equal cases make equal bytes."""
    content = encode_case(case)
    unfinished = path.with_name(f".{path.name}.{os.getpid()}.npz")
    try:
        unfinished.write_bytes(content)
        unfinished.replace(path)
    finally:
        unfinished.unlink(missing_ok=True)


def encode_case(case: Case, *, trial: Mapping[str, object] | None = None) -> bytes:
    """Return a case file's content; ``trial``, plain values for `read_about`, says how an executed action came here."""
    scene, item = case.state.scene, case.state.item
    about: dict[str, object] = {
        "format": FORMAT,
        "name": case.name,
        "seed": case.seed,
        "cell": case.state.grid.cell,
        "true_action": case.true_action,
        "same_item": case.same_item,
        "notes": case.notes,
    }
    if case.task != DEFAULT_TASK:  # files of the default task keep their bytes
        about["task"] = case.task
    if trial is not None:
        about["trial"] = trial
    arrays: dict[str, NDArray[Any]] = {
        "about": np.array(json.dumps(about)),
        "scene_heights": scene.heights,
        "scene_materials": scene.materials,
        "item_heights": item.heights,
        "item_materials": item.materials,
        "target": case.target,
    }
    if scene.bodies is not None:
        arrays["boxes"] = np.array([_numbers(box) for box in scene.bodies.boxes]).reshape(-1, 13)
        if scene.bodies.plate is not None:
            arrays["plate"] = np.stack([scene.bodies.plate.radii, scene.bodies.plate.heights])
    stream = BytesIO()
    np.savez_compressed(stream, allow_pickle=False, **arrays)
    return stream.getvalue()


def read_case(path: Path) -> Case:
    """Read a case.

    Raises:
        RequestError: There is no such file, or it is not a case, or its values are not valid.
    """
    return _read(path, lambda arrays: _case(dict(arrays)))


def read_about(path: Path) -> dict[str, Any]:
    """Read what a case file says in words and single numbers, not its arrays.

    Raises:
        RequestError: There is no such file, or it is not a case.
    """
    return _read(path, _about)


def _read(path: Path, take: Callable[[Mapping[str, NDArray[Any]]], T]) -> T:
    try:
        with path.open("rb") as stream, np.load(stream, allow_pickle=False) as arrays:
            return take(arrays)
    except FileNotFoundError:
        raise RequestError(f"expected a case file, got {path}, which does not exist") from None
    except KeyError as error:
        raise RequestError(f"{path}: expected a case with the array or field {error}, got none") from None
    except BROKEN as error:
        raise RequestError(f"{path}: expected a case file ({FORMAT}), got something else: {error}") from None
    except RequestError as error:
        raise RequestError(f"{path}: {error}") from None


def read_cases(folder: Path) -> tuple[Case, ...]:
    """Read all cases of a folder, by name.

    Raises:
        RequestError: The folder holds no case, or a file is not a valid one.
    """
    paths = sorted(folder.glob("[!.]*.npz"))
    if not paths:
        raise RequestError(f"expected case files (*.npz) in {folder}, got none")
    return tuple(read_case(path) for path in paths)


def _about(arrays: Mapping[str, NDArray[Any]]) -> dict[str, Any]:
    about = json.loads(str(arrays["about"]))
    if not isinstance(about, dict) or about.get("format") != FORMAT:
        raise ValueError(f"its format is {about.get('format') if isinstance(about, dict) else about!r}")
    return about


def _case(arrays: Mapping[str, NDArray[Any]]) -> Case:
    about, heights = _about(arrays), arrays["scene_heights"]
    if heights.ndim != 2:
        raise RequestError(f"scene_heights: expected shape (H, W), got {heights.shape}")
    grid = Grid(*heights.shape, cell=float(about["cell"]))
    bodies = None
    if "boxes" in arrays:
        plate = Plate(*arrays["plate"]) if "plate" in arrays else None
        bodies = Bodies(plate, tuple(_box(numbers) for numbers in arrays["boxes"]))
    scene = Scene(grid, heights, arrays["scene_materials"], bodies)
    action = about["true_action"]
    return Case(
        name=str(about["name"]),
        seed=int(about["seed"]),
        state=State(scene, Item(arrays["item_heights"], arrays["item_materials"])),
        target=arrays["target"],
        true_action=None if action is None else tuple(float(number) for number in action),
        same_item=bool(about["same_item"]),
        notes=str(about["notes"]),
        task=str(about.get("task", DEFAULT_TASK)),
    )


def _numbers(box: Box) -> NDArray[np.float64]:
    """Return size, position, orientation and material of a box ``(13,)``."""
    material = (box.material.density, box.material.youngs_modulus, box.material.poisson_ratio)
    return np.concatenate([box.size, box.position, box.orientation, material])


def _box(numbers: NDArray[np.float64]) -> Box:
    if numbers.shape != (13,):
        raise RequestError(f"boxes: expected 13 numbers each, got {numbers.shape}")
    material = Material(*(float(number) for number in numbers[10:]))
    return Box(numbers[:3], numbers[3:6], numbers[6:10], material)
