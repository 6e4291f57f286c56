"""The heavy elastica: how a clamped, inextensible beam hangs under its own weight, however far it bends."""

import numpy as np
from scipy.integrate import solve_bvp


def hanging_tip(load: float, *, outer_load: float | None = None) -> tuple[float, float]:
    """Return how far the free end is from the clamp along the clamp's axis, and below it, as shares of the length.

    With arc length s in lengths of the beam, slope theta and moment m: ``theta' = load m``, ``m' = (1 - s) cos theta``,
    ``theta(0) = 0``, ``m(1) = 0`` (Bickley 1934).

    Args:
        load: ``w L^3 / (E I)`` with the weight per length ``w``, ``12 rho g L^3 / (E h^2)`` for a rectangle.
        outer_load: The same with the stiffness of the outer half, if that is another.
    """
    loads = load, load if outer_load is None else outer_load

    # Both halves at once, each over t from 0 to 1: slope, moment, x and depth of the inner one, then of the outer one.
    def rates(t, y):
        inner, outer = y[:4], y[4:]
        return np.concatenate(
            [
                0.5 * np.array([loads[i] * half[1], (1 - s) * np.cos(half[0]), np.cos(half[0]), -np.sin(half[0])])
                for i, (half, s) in enumerate(((inner, t / 2), (outer, (1 + t) / 2)))
            ]
        )

    def ends(start, end):
        return np.concatenate([start[[0, 2, 3]], start[4:] - end[:4], end[5:6]])

    t = np.linspace(0, 1, 101)
    guess = np.array(
        [-0.2 * t, -0.5 + 0.4 * t, t / 2, 0.1 * t, -0.2 + 0 * t, 0.1 * t - 0.1, (1 + t) / 2, 0.1 + 0.1 * t]
    )
    solution = solve_bvp(rates, ends, t, guess, tol=1e-8, max_nodes=20_000)
    assert solution.success, solution.message
    return float(solution.y[6, -1]), float(solution.y[7, -1])
