# type: ignore
# Kernels are written in Warp's language, which a checker of Python misreads.
"""The arrays that kernels work on, by what they describe.

``W`` worlds (one action each) share one item and one set of boxes. ``N`` nodes and ``E`` hexahedra of a soft item,
``S`` contact samples on it; ``M`` rigid bodies (a rigid item first, then the boxes) with ``T`` samples; ``K``
obstacles: plate, tray, then the boxes; ``P`` patches of samples, first those of the soft item. Positions in the world
[m], rotations as quaternions.
"""

import warp as wp

DONE = wp.constant(0)
"""At rest, or given up."""
START = wp.constant(1)
"""A time step begins: forces are wanted at its start."""
TRIAL = wp.constant(2)
"""Forces are wanted at a trial point of the line search."""
DIRECTION = wp.constant(3)
"""Forces are known, a Newton direction is wanted."""
ENDED = wp.constant(4)
"""A time step has ended."""

PLATE = wp.constant(0)
TRAY = wp.constant(1)
FIRST_BOX = wp.constant(2)
"""Numbers of the obstacles."""

NEAR_PLATE = wp.constant(1 << 30)
"""The bit that stands for the plate in the bit sets of what is near; the lower ones are boxes."""


@wp.struct
class Laws:
    """Contact, gravity and integrator: `settings.Settings` as the kernels see them."""

    friction: float
    stick_ratio: float
    softening: float
    tray_patience: float
    patience: float  # [s]
    gravity: wp.vec3
    keep_fast: float  # share of the velocity that one step keeps
    keep_slow: float
    slow: float  # [m/s]
    first_step: float
    longest_step: float
    shortest_step: float
    iterations: int
    tolerance: float
    relative_tolerance: float
    tray_speed: float
    rest_displacement: float
    longest_time: float
    stops_at_rest: int


@wp.struct
class Plates:
    """The plate's profile, and by radius which segments are near and what height they reach."""

    radii: wp.array[float]  # (R,)
    heights: wp.array[float]  # (R,)
    bin: float
    first: wp.array[int]  # (Q,) first segment within REACH of each bin
    ceiling: wp.array[float]  # (Q,) nothing of the plate within REACH of a bin is higher


@wp.struct
class Solid:
    """The soft item: mesh, stiffness, mass and contact samples."""

    cells: wp.array2d[int]  # (E, 8)
    rest: wp.array2d[wp.vec3]  # (E, 8) relative to the first node
    gradient: wp.array2d[wp.vec3]  # (E, 8) dN/dX at the centre
    stiffness: wp.array2d[wp.mat33]  # (E, 64)
    mass: wp.array[float]  # (N,)
    pinned: wp.array[float]  # (N,) 1 for nodes that are held
    first_sample: wp.array[int]  # (E + 1,) samples are sorted by hexahedron
    patch: wp.array[int]  # (S,) hexahedron of each sample
    kind: wp.array[int]  # (S,)
    normal_stiffness: wp.array[float]  # (S,)
    corners: wp.array[int]  # (S,) how many of the weights are used, 4 or 8
    weights: wp.array2d[float]  # (S, 8)


@wp.struct
class Rigid:
    """The rigid bodies: mass, shape and contact samples."""

    bodies: int  # M; arrays have one unused entry where it is 0
    first_box: int  # 1 if body 0 is the item
    boxes: int
    first_patch: int
    mass: wp.array[float]  # (M,)
    inertia: wp.array[wp.mat33]  # (M,) in the body's frame
    core: wp.array[wp.vec3]  # (M,) half edges less the rounding; boxes only
    reach: wp.array[float]  # (M,) radius of a sphere around the body
    body: wp.array[int]  # (T,)
    point: wp.array[wp.vec3]  # (T,)
    radius: wp.array[float]  # (T,)
    kind: wp.array[int]  # (T,)
    normal_stiffness: wp.array[float]  # (T,)
    first_sample: wp.array[int]  # (P + 1,) samples are sorted by patch
    patch_body: wp.array[int]  # (P,)
    patch_centre: wp.array[wp.vec3]  # (P,)
    patch_radius: wp.array[float]  # (P,)


@wp.struct
class Worlds:
    """What differs between worlds and changes: positions, velocities, forces, contact memory, step control."""

    x0: wp.array2d[wp.vec3]  # (W, N) at the start of the step
    xb: wp.array2d[wp.vec3]  # at the last accepted iterate
    x: wp.array2d[wp.vec3]  # at the trial point
    v: wp.array2d[wp.vec3]
    f: wp.array2d[wp.vec3]
    d: wp.array2d[wp.vec3]  # Newton direction
    p0: wp.array2d[wp.vec3]  # (W, M) the same for bodies: centres
    pb: wp.array2d[wp.vec3]
    p: wp.array2d[wp.vec3]
    q0: wp.array2d[wp.quat]  # orientations
    qb: wp.array2d[wp.quat]
    q: wp.array2d[wp.quat]
    pv: wp.array2d[wp.vec3]  # velocity, angular velocity
    qv: wp.array2d[wp.vec3]
    pf: wp.array2d[wp.vec3]  # force, torque
    qf: wp.array2d[wp.vec3]
    pd: wp.array2d[wp.vec3]  # direction: shift, turn
    qd: wp.array2d[wp.vec3]
    turn: wp.array2d[wp.mat33]  # (W, E) rotation of each hexahedron
    near: wp.array2d[int]  # (W, P) bit set of what is near each patch
    was_near: wp.array2d[int]
    touched: wp.array2d[int]  # (W, S) bit set of what each sample of the soft item is in contact with
    body_touched: wp.array2d[int]  # (W, T) the same for samples of rigid bodies
    anchor: wp.array3d[wp.vec3]  # (W, S, K) in the obstacle's frame
    grip: wp.array3d[wp.vec3]  # (W, T, K) touching point in the body's frame
    body_anchor: wp.array3d[wp.vec3]  # (W, T, K)
    phase: wp.array[int]  # (W,)
    iteration: wp.array[int]
    trials: wp.array[int]
    alpha: wp.array[float]  # length of the trial step
    slope: wp.array[float]  # f.d at the last iterate
    longest: wp.array[float]  # largest displacement in d [m]
    dt: wp.array[float]
    time: wp.array[float]
    keep: wp.array[float]
    moved: wp.array[float]  # largest displacement in the step [m]
    margin: wp.array[float]  # how far the contact search has looked beyond touching [m]
    speed: wp.array[float]  # largest speed in the last whole step [m/s]
    converged: wp.array[int]
    calm: wp.array[int]  # steps at rest in a row
    fresh: wp.array[int]  # 1 before the first step: no contact has a memory
    tray: wp.array[float]  # height of the tray [m]
    tray_load: wp.array[float]  # [N]
    tray_on: wp.array[int]
    idle: wp.array[float]  # how long the tray has carried nothing [s]


@wp.struct
class System:
    """Newton's equations: an upper band with a border of right-hand side and bodies, and the bodies' dense corner.

    Row ``i`` of the band holds columns ``i .. i + band - 1``, then the right-hand side, then ``6 M`` border columns.
    """

    nodes: int
    band: int  # entries kept for the band in a row
    row: int  # entries in a row
    bordered: wp.array2d[float]  # (W, 3 N row)
    corner: wp.array3d[float]  # (W, 6 M, 6 M) upper half
    corner_load: wp.array2d[float]  # (W, 6 M)
    schur: wp.array2d[float]  # (W, 6 M (6 M + 32)) what the band adds to the corner
