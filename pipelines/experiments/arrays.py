"""Heightmaps in raw results: compressed, as text."""

import base64
import zlib
from typing import Any

import numpy as np
from numpy.typing import NDArray


def pack(heights: NDArray[np.floating]) -> dict[str, Any]:
    """Return an array as float32, ready for JSON."""
    content = zlib.compress(np.ascontiguousarray(heights, dtype="<f4").tobytes())
    return {"shape": list(heights.shape), "zlib_f4": base64.b64encode(content).decode()}


def unpack(packed: dict[str, Any]) -> NDArray[np.float32]:
    """Return what `pack` packed."""
    content = zlib.decompress(base64.b64decode(packed["zlib_f4"]))
    return np.frombuffer(content, dtype="<f4").reshape(packed["shape"]).astype(np.float32)
