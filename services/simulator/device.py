"""How Warp is used: one module for all kernels, quiet, without gradients."""

import os
import sys
import tempfile
from typing import Any

import warp as wp

NO_DRIVER = b"Could not find or load the NVIDIA CUDA driver"


def _init_warp() -> None:
    """Initialise Warp without the line that its library writes to standard error wherever there is no CUDA driver."""
    # At the level of warnings Warp complains wherever there is no CUDA driver.
    wp.config.log_level = wp.LOG_ERROR
    sys.stderr.flush()
    stderr = os.dup(2)
    with tempfile.TemporaryFile() as written:
        os.dup2(written.fileno(), 2)
        try:
            wp.init()
        finally:
            os.dup2(stderr, 2)
            os.close(stderr)
            written.seek(0)
            os.write(2, b"".join(line for line in written if NO_DRIVER not in line))


_init_warp()

MODULE = "frugal_simulator"
"""Name of the Warp module that holds all kernels, so that one compilation is enough."""

# Unrolling the nested 8 x 8 x 3 x 3 loops (the default allows 16) takes the compiler minutes.
wp.set_module_options({"enable_backward": False, "max_unroll": 4}, MODULE)


def upload(values: Any, dtype: Any, device: str) -> Any:
    """Return a Warp array on ``device``; an empty one gets a single zero, for kernels that never read it."""
    array = wp.array(values, dtype=dtype, device=device)
    return array if array.size else wp.zeros((1,) * array.ndim, dtype=dtype, device=device)
