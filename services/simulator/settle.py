"""Let boxes fall on a plate and come to rest."""

from collections.abc import Sequence

import numpy as np

from common.domain.bodies import Box, Plate
from common.domain.errors import ModelError
from services.simulator.settings import Settings


def settle_boxes(
    plate: Plate, boxes: Sequence[Box], *, settings: Settings | None = None, device: str = "cpu"
) -> tuple[Box, ...]:
    """Return the boxes where they come to rest when let go.

    Raises:
        ModelError: They are still moving after `Settings.longest_time`; says how fast.
    """
    if not boxes:
        return ()
    # Warp takes a second to import, and callers of this module need not simulate.
    from services.simulator.bodies import box_body
    from services.simulator.simulation import Simulation

    chosen = settings or Settings()
    simulation = Simulation(
        plate=plate,
        mesh=None,
        samples=None,
        bodies=[box_body(box, chosen) for box in boxes],
        settings=chosen,
        device=device,
    )
    simulation.place(
        np.zeros((1, 0, 3)),
        np.array([[box.position for box in boxes]]),
        np.array([[box.orientation for box in boxes]]),
    )
    outcome = simulation.run()
    if not outcome.settled[0]:
        raise ModelError(
            f"expected {len(boxes)} boxes to come to rest within {chosen.longest_time:g} s, "
            f"got a speed of {1e3 * outcome.speed[0]:.1f} mm/s"
        )
    return tuple(
        Box(box.size, position.astype(np.float64), orientation.astype(np.float64), box.material)
        for box, position, orientation in zip(boxes, outcome.positions[0], outcome.orientations[0], strict=True)
    )
