"""One simulator on every device: threads of a CPU give the same bits, and the kernels compile for a GPU."""

from collections.abc import Callable
from pathlib import Path

import numpy as np
import warp as wp

from common.domain.bodies import Box
from common.domain.scene import Item, State
from common.tasks.plating import dinner_plate
from services.simulator import placement
from services.simulator.device import MODULE
from services.simulator.model import SimulatorModel
from services.simulator.settle import settle_boxes


def test_threads_give_the_same_bits_as_one(
    slab: Callable[..., Item], state_of: Callable[..., State], fry: Callable[..., Box]
) -> None:
    boxes = settle_boxes(dinner_plate(), [fry(0, 0, 0.006, 0.2), fry(0.01, 0.01, 0.018, 1.5)])
    state = state_of(slab(), boxes)
    actions = np.array([[0.0, 0.0], [0.01, -0.02], [0.03, 0.0], [-0.02, 0.02], [0.0, 0.01]])
    one = SimulatorModel().predict(state, actions)
    three = SimulatorModel(threads=3).predict(state, actions)
    assert one.heights.tobytes() == three.heights.tobytes()
    assert one.warnings == three.warnings


def test_the_kernels_compile_for_a_gpu(tmp_path: Path) -> None:
    assert placement.Placement.__module__  # the module that brings in all kernels
    wp.compile_aot_module(MODULE, arch=[80], module_dir=tmp_path, use_ptx=True)
    (assembly,) = tmp_path.glob("*.ptx")
    text = assembly.read_text()
    for kernel in ("touch_soft", "touch_rigid", "solve_newton", "add_elastic_tangent", "draw_triangles", "next_step"):
        assert f".entry {kernel}" in text
