"""What the simulator may be told: resolution, time steps, contact."""

from dataclasses import dataclass


@dataclass(frozen=True)
class Settings:
    """Resolution, integrator and contact of one simulation.

    Attributes:
        cell: Wanted edge of a hexahedron in the plane [m].
        layers: Hexahedra through the thickness.
        samples: Contact samples along each edge of a cell's bottom face.
        box_spacing: Largest distance between the contact samples on a box's edges [m].
        normal_stiffness: Contact stiffness per area of the item's surface [Pa/m].
        point_stiffness: Contact stiffness of one sample of a rigid body [N/m].
        friction: Coefficient of friction [-].
        stick_ratio: Tangential over normal contact stiffness [-].
        softening: Depth up to which a contact's stiffness grows from zero [m].
        first_step: Time step while things move [s].
        longest_step: Time step at rest [s].
        shortest_step: Time step below which no step is halved [s].
        iterations: Most Newton iterations a step.
        tolerance: A step has converged when its last iteration moved nothing by more than this [m],
        relative_tolerance: or by this share of the whole step [-].
        keep_fast: Share of the velocity that a step keeps while things move [-].
        keep_slow: The same once they are slow [-].
        slow: Speed below which they are slow [m/s].
        tray_speed: Speed at which the tray lowers the item [m/s].
        tray_patience: How long the tray must have carried nothing before it goes away [s].
        patience: Time after which steps that do not converge are halved and get three times the iterations [s];
            before it they are taken as they are.
        rest_displacement: Displacement in one step below which everything is at rest [m].
        longest_time: Simulated time after which the item counts as not settled [s].
        stiffest: Young's modulus to which stiff parts of a soft item are capped [Pa]: beyond it they no longer
            deform visibly, and the factorisation in single precision loses digits.
    """

    cell: float = 0.012
    layers: int = 3
    samples: int = 9
    box_spacing: float = 0.0018
    normal_stiffness: float = 1.2e9
    point_stiffness: float = 1e4
    friction: float = 0.5
    stick_ratio: float = 0.7
    softening: float = 2e-4
    first_step: float = 0.020
    longest_step: float = 0.030
    shortest_step: float = 0.005
    iterations: int = 3
    tolerance: float = 2e-6
    relative_tolerance: float = 0.02
    keep_fast: float = 0.9
    keep_slow: float = 0.5
    slow: float = 0.02
    tray_speed: float = 0.12
    tray_patience: float = 0.05
    patience: float = 0.8
    rest_displacement: float = 5e-6
    longest_time: float = 3.0
    stiffest: float = 1e7


LEVELS: dict[str, Settings] = {
    "coarse": Settings(cell=0.022, layers=2, samples=16),
    "default": Settings(),
    "fine": Settings(cell=0.006, layers=4, samples=6, first_step=0.010, longest_step=0.015),
}
"""Named resolutions, cheapest first."""
