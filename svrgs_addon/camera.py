"""A pinhole camera in COLMAP's frame: x right, y down, z forward; pixel centres at k + 0.5."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np


@dataclass(frozen=True)
class Camera:
    """World-to-camera pose and intrinsics of one view."""

    viewmat: np.ndarray  # (4, 4) float64, world to camera
    K: np.ndarray  # (3, 3) float64, pixels
    width: int
    height: int
    name: str = ""  # image name, '/' between folders

    @property
    def position(self) -> np.ndarray:
        """Camera centre in world coordinates, (3,) float64."""
        R, t = self.viewmat[:3, :3], self.viewmat[:3, 3]
        return -R.T @ t

    def resized(self, width: int, height: int) -> Camera:
        """The same view at another image size; intrinsics scale by the real size ratio of each axis."""
        scale = np.diag([width / self.width, height / self.height, 1.0])
        return replace(self, K=scale @ self.K, width=width, height=height)

    def reduced(self, factor: int) -> Camera:
        """The same view with factor x factor pixels in one; a rest of fewer than `factor` columns or rows is left out.

        Exact: the centre k + 0.5 of a pixel is the centre of the block it stands for.
        """
        return replace(self, K=np.diag([1 / factor, 1 / factor, 1.0]) @ self.K, width=self.width // factor, height=self.height // factor)
