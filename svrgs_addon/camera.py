"""A perspective or orthographic camera in COLMAP's frame: x right, y down, z forward; pixel centres at k + 0.5."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import PurePosixPath

import numpy as np


@dataclass(frozen=True)
class Camera:
    """World-to-camera pose and intrinsics of one view: (x, y, z) is seen at (fx x / z + cx, fy y / z + cy)."""

    viewmat: np.ndarray  # (4, 4) float64, world to camera
    K: np.ndarray  # (3, 3) float64, pixels; orthographic: focal lengths in pixels per unit of length
    width: int
    height: int
    name: str = ""  # image name, '/' between folders
    orthographic: bool = False  # parallel rays: no division by z, and every colour is seen along the camera's axis

    @property
    def position(self) -> np.ndarray:
        """Camera centre in world coordinates, (3,) float64."""
        R, t = self.viewmat[:3, :3], self.viewmat[:3, 3]
        return -R.T @ t

    @property
    def key(self) -> bytes:
        """What tells this view from another, its name aside."""
        return np.array([*self.viewmat.flat, *self.K.flat, self.width, self.height, self.orthographic], np.float64).tobytes()

    def pixels(self, points: np.ndarray) -> np.ndarray:
        """(..., 2) float64: where points (..., 3) of the camera's frame are seen; means nothing where z <= 0."""
        with np.errstate(divide="ignore", invalid="ignore"):
            plane = points[..., :2] if self.orthographic else points[..., :2] / points[..., 2:]
        return plane @ self.K[:2, :2].T + self.K[:2, 2]

    def directions(self, points: np.ndarray) -> np.ndarray:
        """(N, 3) unit vectors along which the camera looks at points (N, 3) of the world, in their dtype."""
        if self.orthographic:
            return np.broadcast_to(self.viewmat[2, :3].astype(points.dtype), points.shape)
        rays = points - self.position.astype(points.dtype)
        return rays / np.maximum(np.linalg.norm(rays, axis=1, keepdims=True), 1e-12)

    def moved(self, matrix: np.ndarray) -> Camera:
        """The same view for points that `matrix` (4, 4) brings into this camera's world: a rotation, a translation and one scale s.

        Lengths of the new camera, depths among them, are 1 / s of this one's.
        """
        viewmat: np.ndarray = self.viewmat @ np.asarray(matrix, np.float64)
        scale = abs(np.linalg.det(viewmat[:3, :3])) ** (1 / 3)
        viewmat[:3] /= scale
        return replace(self, viewmat=viewmat, K=self.K @ np.diag([scale, scale, 1.0]) if self.orthographic else self.K)

    def resized(self, width: int, height: int) -> Camera:
        """The same view at another image size; intrinsics scale by the real size ratio of each axis."""
        scale = np.diag([width / self.width, height / self.height, 1.0])
        return replace(self, K=scale @ self.K, width=width, height=height)

    def reduced(self, factor: int) -> Camera:
        """The same view with factor x factor pixels in one; a rest of fewer than `factor` columns or rows is left out.

        Exact: the centre k + 0.5 of a pixel is the centre of the block it stands for.
        """
        return replace(self, K=np.diag([1 / factor, 1 / factor, 1.0]) @ self.K, width=self.width // factor, height=self.height // factor)


def view_stem(name: str) -> str:
    """The image name without its extension; folders stay, and so does a number after a dot."""
    path = PurePosixPath(name)
    return str(path if path.suffix[1:].isdecimal() else path.with_suffix(""))
