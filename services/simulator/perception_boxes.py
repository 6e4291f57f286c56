"""Boxes as they look from above, with soft edges so that they can be fitted.

A row of parameters is ``(x, y, z, yaw, pitch, roll, length, width)``: the centre of the upper face [m], the direction
of the long axis [rad], the slopes of the long and the short axis [-], and the edges [m]; the section is square.
"""

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

LENGTH, WIDTH = 0.060, 0.010
"""Edges that a fry is expected to have [m]."""


def axes(boxes: Array) -> Array:
    """Return the unit axes of boxes ``(..., 8)`` as rows ``(..., 3, 3)``: along, across, up."""
    cos, sin, pitch, roll = np.cos(boxes[..., 3]), np.sin(boxes[..., 3]), boxes[..., 4], boxes[..., 5]
    stretch = 1 / np.sqrt(1 + pitch**2)
    lean = 1 / np.sqrt(1 + roll**2 / (1 + pitch**2))
    shear = -roll * pitch * stretch**2  # what makes (-sin, cos, roll) orthogonal to (cos, sin, pitch)
    along = (cos * stretch, sin * stretch, pitch * stretch)
    across = ((shear * cos - sin) * lean, (shear * sin + cos) * lean, (shear * pitch + roll) * lean)
    up = tuple(along[i - 2] * across[i - 1] - along[i - 1] * across[i - 2] for i in range(3))
    return np.stack([*along, *across, *up], axis=-1).reshape(*boxes.shape[:-1], 3, 3)


def soft_tops(boxes: Array, points: Array, ground: Array, blur: float) -> Array:
    """Return the heights of boxes over points, their outline blurred into the ground over ``blur``.

    The upper face continues down the side faces that can be seen from above.

    Args:
        boxes: ``(..., 8)``.
        points: ``(N, 2)`` [m].
        ground: Height of what is below each point ``(N,)`` [m].
        blur: Width of the ramp that stands for the edge, the grid's cell [m].

    Returns:
        Heights ``(..., N)`` [m].
    """
    frame = axes(boxes)
    flat = frame[..., :2, :2]  # rows: along and across seen from above
    determinant = flat[..., 0, 0] * flat[..., 1, 1] - flat[..., 0, 1] * flat[..., 1, 0]
    offset = points - boxes[..., None, :2]
    top = np.broadcast_to(boxes[..., 2, None], offset.shape[:-1]).copy()
    cover = np.ones_like(top)
    drop = np.zeros_like(top)
    down = -frame[..., 2, :2]
    for axis, sign in ((0, 1.0), (1, -1.0)):
        other = flat[..., 1 - axis, :]
        coordinate = sign * _cross(offset, other[..., None, :]) / determinant[..., None]
        side = boxes[..., 7] * sign * _cross(down, other) / determinant  # how far the lower face is displaced
        half = boxes[..., 6 + axis] / 2
        stretch = np.linalg.norm(flat[..., axis, :], axis=-1)[..., None]
        low, high = -half + np.minimum(side, 0), half + np.maximum(side, 0)
        inside = np.minimum(coordinate - low[..., None], high[..., None] - coordinate) * stretch
        cover *= np.clip(0.5 + inside / blur, 0, 1)
        top += np.clip(coordinate, -half[..., None], half[..., None]) * frame[..., axis, 2, None]
        beyond = (coordinate * np.sign(side)[..., None] - half[..., None]) / np.maximum(np.abs(side), 1e-5)[..., None]
        drop = np.maximum(drop, np.clip(beyond, 0, 1))
    top -= drop * (boxes[..., 7] * frame[..., 2, 2])[..., None]
    return ground + np.maximum(top - ground, 0) * cover


def close_to(box: Array, points: Array, *, margin: float) -> NDArray[np.bool_]:
    """Return which points ``(N, 2)`` lie under a box ``(8,)`` or within ``margin`` of it, seen from above [m]."""
    offset, cos, sin = points - box[:2], np.cos(box[3]), np.sin(box[3])
    reach = box[6:] / 2 + np.abs(box[4:6]) * box[7] + margin
    return (np.abs(offset @ (cos, sin)) < reach[0]) & (np.abs(offset @ (-sin, cos)) < reach[1])


def overlaps(boxes: Array) -> Array:
    """Return the largest share of each box's volume that lies inside one other box ``(K,)``."""
    frame = axes(boxes)
    half = boxes[:, [6, 7, 7]] / 2
    centre = boxes[:, :3] - frame[:, 2] * half[:, 2:]
    lattice = np.stack(np.meshgrid(np.linspace(-0.9, 0.9, 13), *2 * [[-0.67, 0.0, 0.67]]), axis=-1).reshape(-1, 3)
    points = centre[:, None] + (lattice * half[:, None]) @ frame
    local = np.einsum("ipjc,jac->ipja", points[:, :, None] - centre, frame)  # point p of box i in the frame of box j
    shares = (np.abs(local) < half).all(axis=-1).mean(axis=1)
    np.fill_diagonal(shares, 0)
    return shares.max(axis=1)


def _cross(first: Array, second: Array) -> Array:
    return first[..., 0] * second[..., 1] - first[..., 1] * second[..., 0]
