"""A depth camera: where each pixel of its image lies in the plate's frame."""

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from common.domain.errors import RequestError
from common.domain.grid import Floats

Vectors = NDArray[np.float64]


@dataclass(frozen=True)
class Camera:
    """A pinhole camera without distortion; x to the right, y down, z forward.

    Attributes:
        fx: Focal length along x [pixel].
        fy: Focal length along y [pixel].
        cx: Column of the principal point [pixel].
        cy: Row of the principal point [pixel].
        rotation: From the camera's axes to the plate's ``(3, 3)``.
        position: Of the camera in the plate's frame, z up, the plate's centre as origin ``(3,)`` [m].

    Raises:
        RequestError: A focal length is not positive, or the rotation is none.
    """

    fx: float
    fy: float
    cx: float
    cy: float
    rotation: Vectors
    position: Vectors

    def __post_init__(self) -> None:
        numbers = np.array([self.fx, self.fy, self.cx, self.cy])
        if not np.isfinite(numbers).all() or self.fx <= 0 or self.fy <= 0:
            raise RequestError(f"intrinsics: expected finite numbers and focal lengths above 0, got {numbers.tolist()}")
        if self.rotation.shape != (3, 3) or self.position.shape != (3,) or not np.isfinite(self.position).all():
            raise RequestError("pose: expected a rotation (3, 3) and a finite position (3,)")
        is_rotation = np.allclose(self.rotation @ self.rotation.T, np.eye(3), atol=1e-3)
        if not (is_rotation and np.linalg.det(self.rotation) > 0):
            raise RequestError(f"pose: expected a rotation, got {np.round(self.rotation, 4).tolist()}")

    def points(self, depth: Floats, *, cuts: int = 1) -> Vectors:
        """Return the points of a depth image in the plate's frame ``(h, w, cuts * cuts, 3)`` [m].

        Args:
            depth: Distances along z ``(h, w)`` [m].
            cuts: Points along each axis of a pixel, which faces the camera.
        """
        part = (np.arange(cuts) + 0.5) / cuts - 0.5
        part_rows, part_columns = (offset.ravel() for offset in np.meshgrid(part, part, indexing="ij"))
        rows, columns = np.indices(depth.shape)[..., None]
        x, y = (columns + part_columns - self.cx) / self.fx, (rows + part_rows - self.cy) / self.fy
        return (np.stack([x, y, np.ones_like(x)], axis=-1) * depth[..., None, None]) @ self.rotation.T + self.position

    def moved(self, offset: Floats) -> "Camera":
        """Return the camera with the plate's frame moved by ``(x, y)`` [m]."""
        return replace(self, position=self.position - np.array([offset[0], offset[1], 0.0]))
