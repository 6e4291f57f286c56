# pyright: reportMissingImports=false, reportAttributeAccessIssue=false
# The package is optional, and its compiled part has no stubs.
"""MuJoCo's flex (every node free) on the scene of the peers: linear tetrahedra, St. Venant-Kirchhoff, sharp boxes."""

from dataclasses import dataclass

import mujoco
import numpy as np
from numpy.typing import NDArray

from common.domain.bodies import Box
from pipelines.bench.peer import Peer
from pipelines.bench.peer_scene import FRICTION, START_SPEED, STEAK, PeerScene

RADIUS = 5e-4
DAMPING = 0.01


@dataclass(frozen=True)
class MujocoSettings:
    """Time step [s] and integrator of one run."""

    step_s: float
    integrator: str = "discrete"


MUJOCO_SETTINGS = (MujocoSettings(0.010), MujocoSettings(0.005), MujocoSettings(0.002))
"""From cheap to dear; the first that agrees counts."""


class MujocoPeer(Peer):
    """MuJoCo's flex, item and fries together; its nodes are half a contact radius inside the surface."""

    name = f"MuJoCo {mujoco.__version__} flex"

    def __init__(self, scene: PeerScene, chosen: MujocoSettings) -> None:
        self.step_s = chosen.step_s
        self.settings = {
            "step_s": chosen.step_s,
            "integrator": chosen.integrator,
            "damping_s": DAMPING,
            "radius_m": RADIUS,
        }
        self._shape = scene.nodes.shape
        self.warnings = []
        mujoco.set_mju_user_warning(self.warnings.append)  # else it writes a log into the working directory
        self._model = mujoco.MjModel.from_xml_string(_xml(scene, chosen))
        self._data = mujoco.MjData(self._model)
        self._data.qvel[6 * len(scene.boxes) + 2 :: 3] = -START_SPEED
        mujoco.mj_forward(self._model, self._data)

    def advance(self) -> None:
        """Take one step."""
        mujoco.mj_step(self._model, self._data)

    def nodes(self) -> NDArray[np.float64]:
        """Return where the flex's vertices are, on its contact surface above ``(I, J, L, 3)`` [m]."""
        lifted = np.array(self._data.flexvert_xpos).reshape(self._shape)
        lifted[:, :, -1, 2] += RADIUS
        return lifted


def _xml(scene: PeerScene, chosen: MujocoSettings) -> str:
    friction = f'friction="{FRICTION} 0.005 0.0001"'
    bodies = "".join(_body(box, friction) for box in scene.boxes)
    points = _numbers(scene.nodes.ravel())
    elements = " ".join(str(number) for number in scene.tetrahedra.ravel())
    return f"""
    <mujoco>
      <option timestep="{chosen.step_s}" integrator="{chosen.integrator}"/>
      <size memory="400M"/>
      <worldbody>
        <geom type="plane" size="1 1 0.1" {friction}/>
        {bodies}
        <flexcomp name="steak" type="direct" dim="3" mass="{STEAK.density * scene.volume}" radius="{RADIUS}"
                  pos="0 0 {RADIUS}" point="{points}" element="{elements}">
          <elasticity young="{STEAK.youngs_modulus}" poisson="{STEAK.poisson_ratio}" damping="{DAMPING}"/>
          <contact selfcollide="none" {friction}/>
        </flexcomp>
      </worldbody>
    </mujoco>"""


def _body(box: Box, friction: str) -> str:
    x, y, z, w = box.orientation
    return (
        f'<body pos="{_numbers(box.position)}" quat="{_numbers([w, x, y, z])}"><freejoint/>'
        f'<geom type="box" size="{_numbers(box.size / 2)}" density="{box.material.density}" {friction}/></body>'
    )


def _numbers(values: NDArray[np.float64] | list[float]) -> str:
    return " ".join(f"{value:.9g}" for value in values)
