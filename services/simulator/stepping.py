# type: ignore
# Kernels are written in Warp's language, which a checker of Python misreads.
"""Implicit Euler with Newton's method: inertia, line search, step control. One small state machine per world.

A step from ``x0, v`` solves ``M (x - x0 - dt v) / dt^2 = f(x)``. A Newton direction ``d`` is tried at length 1, or at
what moves nothing by more than `STEP_LIMIT`; with the slope ``S = f.d`` it is accepted where ``S_new >= -S / 2``,
else shortened. What is wanted is the state at rest: a step that has not converged is taken as it is, on a smaller
time step.
"""

# float(0.0) declares a variable that a loop may change, 0.0 a constant, and there is no `in`.
# ruff: noqa: UP018, SIM109

import warp as wp

from services.simulator.arrays import (
    DIRECTION,
    DONE,
    ENDED,
    START,
    TRIAL,
    Laws,
    Rigid,
    Solid,
    System,
    Worlds,
)
from services.simulator.device import MODULE
from services.simulator.memory import search_margin

STEP_LIMIT = wp.constant(0.0025)
"""Largest displacement of one Newton iteration [m]."""
TRIALS = wp.constant(4)
"""Most lengths of one direction that are tried."""
GROWTH = wp.constant(1.6)
PIN = wp.constant(1.0e7)
"""Stiffness that holds pinned nodes [N/m]."""


@wp.func(module=MODULE)
def turned(turn: wp.vec3, orientation: wp.quat):
    """Return an orientation after a rotation vector in world axes."""
    angle = wp.length(turn)
    if angle < 1.0e-9:
        return orientation
    return wp.normalize(wp.quat_from_axis_angle(turn / angle, angle) * orientation)


@wp.func(module=MODULE)
def world_inertia(rigid: Rigid, body: int, orientation: wp.quat):
    """Return a body's inertia in world axes ``(3, 3)`` [kg m2]."""
    rotation = wp.quat_to_matrix(orientation)
    return rotation * rigid.inertia[body] * wp.transpose(rotation)


@wp.func(module=MODULE)
def wants_forces(phase: int):
    """Tell whether forces are evaluated in this phase."""
    return phase == START or phase == TRIAL


@wp.kernel(module=MODULE)
def begin_nodes(laws: Laws, solid: Solid, worlds: Worlds):
    """Start each node's force with weight and inertia."""
    w, i = wp.tid()
    if not wants_forces(worlds.phase[w]):
        return
    dt = worlds.dt[w]
    lag = worlds.x[w, i] - worlds.x0[w, i] - dt * worlds.v[w, i]
    held = worlds.x[w, i] - worlds.x0[w, i]
    worlds.f[w, i] = solid.mass[i] * (laws.gravity - lag / (dt * dt)) - solid.pinned[i] * PIN * held


@wp.kernel(module=MODULE)
def begin_bodies(laws: Laws, rigid: Rigid, worlds: Worlds):
    """Start each body's force and torque with weight and inertia; gyroscopic torque is left out."""
    w, b = wp.tid()
    if not wants_forces(worlds.phase[w]):
        return
    dt = worlds.dt[w]
    lag = worlds.p[w, b] - worlds.p0[w, b] - dt * worlds.pv[w, b]
    worlds.pf[w, b] = rigid.mass[b] * (laws.gravity - lag / (dt * dt))
    expected = turned(dt * worlds.qv[w, b], worlds.q0[w, b])
    behind = worlds.q[w, b] * wp.quat_inverse(expected)
    turn = 2.0 * wp.sign(behind[3]) * wp.vec3(behind[0], behind[1], behind[2])
    worlds.qf[w, b] = -(world_inertia(rigid, b, worlds.q0[w, b]) * turn) / (dt * dt)


@wp.kernel(module=MODULE)
def judge(laws: Laws, rigid: Rigid, worlds: Worlds):
    """Decide what comes next: a shorter trial, another direction, or the end of the step."""
    w = wp.tid()
    phase = worlds.phase[w]
    if phase == START:
        worlds.iteration[w] = 0
        worlds.phase[w] = DIRECTION
    if phase != TRIAL:
        return
    slope = float(0.0)
    for i in range(worlds.x.shape[1]):
        slope += wp.dot(worlds.f[w, i], worlds.d[w, i])
    for b in range(rigid.bodies):
        slope += wp.dot(worlds.pf[w, b], worlds.pd[w, b]) + wp.dot(worlds.qf[w, b], worlds.qd[w, b])
    first = worlds.slope[w]
    trials = worlds.trials[w] + 1
    worlds.trials[w] = trials
    last = worlds.alpha[w] * worlds.longest[w]
    if slope < -0.5 * first and trials < TRIALS and last > laws.tolerance:
        worlds.alpha[w] = worlds.alpha[w] * wp.clamp(first / (first - slope), 0.15, 0.7)
        return
    moved = float(0.0)
    for i in range(worlds.x.shape[1]):
        moved = wp.max(moved, wp.length(worlds.x[w, i] - worlds.x0[w, i]))
    for b in range(rigid.bodies):
        turn = worlds.q[w, b] * wp.quat_inverse(worlds.q0[w, b])
        swing = 2.0 * wp.length(wp.vec3(turn[0], turn[1], turn[2])) * rigid.reach[b]
        moved = wp.max(moved, wp.length(worlds.p[w, b] - worlds.p0[w, b]) + swing)
    worlds.moved[w] = moved
    iteration = worlds.iteration[w] + 1
    worlds.iteration[w] = iteration
    worlds.phase[w] = DIRECTION
    if iteration >= 2 and last < wp.max(laws.tolerance, laws.relative_tolerance * moved):
        worlds.converged[w] = 1
        worlds.phase[w] = ENDED
    elif moved > worlds.margin[w] or iteration >= laws.iterations * (1 + 2 * int(worlds.time[w] > laws.patience)):
        worlds.converged[w] = 0
        worlds.phase[w] = ENDED
    if worlds.phase[w] == ENDED:
        worlds.keep[w] = laws.keep_fast
        if worlds.converged[w] == 1 and moved < laws.slow * worlds.dt[w]:
            worlds.keep[w] = laws.keep_slow
        worlds.tray_load[w] = 0.0


@wp.kernel(module=MODULE)
def accept_nodes(worlds: Worlds):
    """Make the trial point the new iterate; at the end of a step also take the velocity."""
    w, i = wp.tid()
    phase = worlds.phase[w]
    if phase == DIRECTION or phase == ENDED:
        worlds.xb[w, i] = worlds.x[w, i]
    if phase == ENDED:
        worlds.v[w, i] = (worlds.x[w, i] - worlds.x0[w, i]) * (worlds.keep[w] / worlds.dt[w])
        worlds.x0[w, i] = worlds.x[w, i]


@wp.kernel(module=MODULE)
def accept_bodies(worlds: Worlds):
    """Make the trial poses the new iterate; at the end of a step also take the velocities."""
    w, b = wp.tid()
    phase = worlds.phase[w]
    if phase == DIRECTION or phase == ENDED:
        worlds.pb[w, b] = worlds.p[w, b]
        worlds.qb[w, b] = worlds.q[w, b]
    if phase == ENDED:
        rate = worlds.keep[w] / worlds.dt[w]
        worlds.pv[w, b] = (worlds.p[w, b] - worlds.p0[w, b]) * rate
        turn = worlds.q[w, b] * wp.quat_inverse(worlds.q0[w, b])
        worlds.qv[w, b] = 2.0 * wp.sign(turn[3]) * wp.vec3(turn[0], turn[1], turn[2]) * rate
        worlds.p0[w, b] = worlds.p[w, b]
        worlds.q0[w, b] = worlds.q[w, b]


@wp.kernel(module=MODULE)
def next_step(laws: Laws, worlds: Worlds):
    """Choose the next time step and move the tray, or stop at rest."""
    w = wp.tid()
    if worlds.phase[w] != ENDED:
        return
    worlds.phase[w] = START
    worlds.margin[w] = search_margin(worlds, w)
    if worlds.fresh[w] == 1:  # contacts have just been given their first anchors, nothing has moved yet
        worlds.fresh[w] = 0
        worlds.tray[w] = worlds.tray[w] - laws.tray_speed * worlds.dt[w]
        return
    dt = worlds.dt[w]
    worlds.time[w] = worlds.time[w] + dt
    worlds.speed[w] = worlds.moved[w] / dt
    slow = worlds.moved[w] < laws.slow * dt
    still = worlds.converged[w] == 1 and worlds.tray_on[w] == 0 and worlds.moved[w] < laws.rest_displacement
    if still and dt >= 0.6 * laws.longest_step:
        worlds.calm[w] = worlds.calm[w] + 1
    else:
        worlds.calm[w] = 0
    if worlds.converged[w] == 0:
        shortest = laws.first_step
        if worlds.time[w] > laws.patience:
            shortest = laws.shortest_step
        dt = wp.max(0.5 * dt, shortest)
    elif slow and worlds.tray_on[w] == 0:
        dt = wp.min(GROWTH * dt, laws.longest_step)
    else:
        dt = wp.min(GROWTH * dt, laws.first_step)
    worlds.dt[w] = dt
    if worlds.tray_on[w] == 1:
        if worlds.tray_load[w] == 0.0:
            worlds.idle[w] = worlds.idle[w] + dt
        else:
            worlds.idle[w] = 0.0
        worlds.tray[w] = worlds.tray[w] - laws.tray_speed * dt
        if worlds.idle[w] > laws.tray_patience:
            worlds.tray_on[w] = 0
    if laws.stops_at_rest == 1 and worlds.calm[w] >= 2:
        worlds.phase[w] = DONE
    if worlds.time[w] > laws.longest_time:
        worlds.phase[w] = DONE


@wp.func_native("""
    float* const target = bordered.data + (long long)w * bordered.shape[1] + start;
    for (int k = 0; k < count; ++k) target[k] = 0.0f;
""")
def clear_row(bordered: wp.array2d[float], w: int, start: int, count: int):
    """Set a stretch of world ``w`` to zero; compiled to a single fill."""
    ...


@wp.kernel(module=MODULE)
def begin_system(solid: Solid, worlds: Worlds, system: System):
    """Put mass and force of each node into the band."""
    w, i = wp.tid()
    if worlds.phase[w] != DIRECTION:
        return
    dt = worlds.dt[w]
    for axis in range(3):
        start = (3 * i + axis) * system.row
        clear_row(system.bordered, w, start, system.row)
        system.bordered[w, start] = solid.mass[i] / (dt * dt) + solid.pinned[i] * PIN
        system.bordered[w, start + system.band] = worlds.f[w, i][axis]


@wp.kernel(module=MODULE)
def begin_corner(rigid: Rigid, worlds: Worlds, system: System):
    """Put inertia and force of each body into the corner."""
    w, b = wp.tid()
    if worlds.phase[w] != DIRECTION:
        return
    rate = 1.0 / (worlds.dt[w] * worlds.dt[w])
    inertia = world_inertia(rigid, b, worlds.q0[w, b])
    for r in range(6):
        for c in range(system.corner.shape[2]):
            system.corner[w, 6 * b + r, c] = 0.0
    for r in range(3):
        system.corner[w, 6 * b + r, 6 * b + r] = rigid.mass[b] * rate
        for c in range(3):
            if c >= r:
                system.corner[w, 6 * b + 3 + r, 6 * b + 3 + c] = inertia[r, c] * rate
        system.corner_load[w, 6 * b + r] = worlds.pf[w, b][r]
        system.corner_load[w, 6 * b + 3 + r] = worlds.qf[w, b][r]


@wp.kernel(module=MODULE)
def aim(rigid: Rigid, worlds: Worlds):
    """Begin the line search along a new direction."""
    w = wp.tid()
    if worlds.phase[w] != DIRECTION:
        return
    slope = float(0.0)
    longest = float(0.0)
    for i in range(worlds.x.shape[1]):
        slope += wp.dot(worlds.f[w, i], worlds.d[w, i])
        longest = wp.max(longest, wp.length(worlds.d[w, i]))
    for b in range(rigid.bodies):
        slope += wp.dot(worlds.pf[w, b], worlds.pd[w, b]) + wp.dot(worlds.qf[w, b], worlds.qd[w, b])
        longest = wp.max(longest, wp.length(worlds.pd[w, b]) + rigid.reach[b] * wp.length(worlds.qd[w, b]))
    worlds.slope[w] = slope
    worlds.longest[w] = longest
    worlds.alpha[w] = wp.min(1.0, STEP_LIMIT / wp.max(longest, 1.0e-12))
    worlds.trials[w] = 0
    worlds.phase[w] = TRIAL


@wp.kernel(module=MODULE)
def try_nodes(worlds: Worlds):
    """Move the nodes to the trial point."""
    w, i = wp.tid()
    if worlds.phase[w] == TRIAL:
        worlds.x[w, i] = worlds.xb[w, i] + worlds.alpha[w] * worlds.d[w, i]


@wp.kernel(module=MODULE)
def try_bodies(worlds: Worlds):
    """Move the bodies to the trial poses."""
    w, b = wp.tid()
    if worlds.phase[w] == TRIAL:
        worlds.p[w, b] = worlds.pb[w, b] + worlds.alpha[w] * worlds.pd[w, b]
        worlds.q[w, b] = turned(worlds.alpha[w] * worlds.qd[w, b], worlds.qb[w, b])
