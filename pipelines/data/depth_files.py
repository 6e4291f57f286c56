"""Files of a depth camera: images as 16-bit PNG or NPY, intrinsics and pose as JSON."""

import json
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from common.domain.camera import Camera
from common.domain.errors import RequestError


def read_depth(path: Path, *, scale: float = 0.001) -> NDArray[np.float64]:
    """Read a depth image ``(h, w)`` [m].

    Args:
        path: A PNG of 16 bits, or an array (.npy); floating point numbers are metres.
        scale: What one unit of a whole number means [m].

    Raises:
        RequestError: There is no such file, or it is not a depth image.
    """
    if not path.is_file():
        raise RequestError(f"expected a depth image at {path}, got no file")
    if path.suffix.lower() == ".npy":
        values = _read_npy(path)
    elif path.suffix.lower() == ".png":
        values = _read_png(path)
    else:
        raise RequestError(f"expected a depth image as .png or .npy, got {path}")
    if values.ndim != 2 or values.dtype.kind not in "uif":
        raise RequestError(f"{path}: expected one number a pixel (h, w), got {values.dtype} {values.shape}")
    return values.astype(np.float64) * (1.0 if values.dtype.kind == "f" else scale)


def read_camera(intrinsics: Path, pose: Path) -> Camera:
    """Read a camera from its intrinsics ``{"fx", "fy", "cx", "cy"}`` and its pose, both JSON.

    The pose is the 4 x 4 matrix from the camera's frame (x right, y down, z forward) to the plate's (z up, origin at
    the centre of its flat), as a list of rows or as ``{"matrix": rows}``.

    Raises:
        RequestError: A file is missing or holds something else.
    """
    numbers = _read_json(intrinsics)
    missing = [name for name in ("fx", "fy", "cx", "cy") if not isinstance(numbers, dict) or name not in numbers]
    if missing:
        raise RequestError(f"{intrinsics}: expected fx, fy, cx and cy, got no {', '.join(missing)}")
    content = _read_json(pose)
    rows = content.get("matrix") if isinstance(content, dict) else content
    try:
        matrix = np.array(rows, dtype=np.float64)
        fx, fy, cx, cy = (float(numbers[name]) for name in ("fx", "fy", "cx", "cy"))
    except (TypeError, ValueError):
        raise RequestError(f"{intrinsics}, {pose}: expected numbers, got something else") from None
    if matrix.shape != (4, 4) or not np.allclose(matrix[3], (0, 0, 0, 1)):
        raise RequestError(f"{pose}: expected a 4 x 4 matrix whose last row is 0 0 0 1, got shape {matrix.shape}")
    return Camera(fx, fy, cx, cy, matrix[:3, :3], matrix[:3, 3])


def _read_npy(path: Path) -> NDArray[Any]:
    try:
        return np.load(path, allow_pickle=False)
    except (ValueError, OSError, EOFError) as error:
        raise RequestError(f"{path}: expected an array, got something else: {error}") from None


def _read_png(path: Path) -> NDArray[Any]:
    from PIL import Image, UnidentifiedImageError

    try:
        with Image.open(path) as image:
            if image.mode not in ("I;16", "I;16B", "I"):
                raise RequestError(f"{path}: expected 16 bits of grey a pixel, got mode {image.mode}")
            return np.asarray(image)
    except (UnidentifiedImageError, OSError) as error:
        raise RequestError(f"{path}: expected a PNG, got something else: {error}") from None


def _read_json(path: Path) -> Any:
    try:
        return json.loads(path.read_text())
    except FileNotFoundError:
        raise RequestError(f"expected a JSON file at {path}, got none") from None
    except ValueError as error:
        raise RequestError(f"{path}: expected JSON, got something else: {error}") from None
