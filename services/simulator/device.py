"""How Warp is used: one module for all kernels, quiet, without gradients."""

from typing import Any

import warp as wp

# At the level of warnings Warp complains wherever there is no CUDA driver.
wp.config.log_level = wp.LOG_ERROR

MODULE = "frugal_simulator"
"""Name of the Warp module that holds all kernels, so that one compilation is enough."""

# Unrolling the nested 8 x 8 x 3 x 3 loops (the default allows 16) takes the compiler minutes.
wp.set_module_options({"enable_backward": False, "max_unroll": 4}, MODULE)


def upload(values: Any, dtype: Any, device: str) -> Any:
    """Return a Warp array on ``device``; an empty one gets a single zero, for kernels that never read it."""
    array = wp.array(values, dtype=dtype, device=device)
    return array if array.size else wp.zeros((1,) * array.ndim, dtype=dtype, device=device)
