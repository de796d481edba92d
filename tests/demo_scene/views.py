"""Cameras: their optics and their poses. Plain NumPy: no Blender here."""

from dataclasses import dataclass

import numpy as np


@dataclass(frozen=True)
class Intrinsics:
    """A pinhole in pixels; pixel centres lie at k + 0.5."""

    width: int
    height: int
    focal: float

    @property
    def matrix(self) -> np.ndarray:
        """(3, 3) float64."""
        half = self.width / 2, self.height / 2
        return np.array([[self.focal, 0, half[0]], [0, self.focal, half[1]], [0, 0, 1.0]])

    def project(self, world_to_camera: np.ndarray, xyz: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """World points (N, 3) to pixels (N, 2) and depths (N,) along the viewing axis."""
        xyz_c = xyz @ world_to_camera[:3, :3].T + world_to_camera[:3, 3]
        uvw = xyz_c @ self.matrix.T
        with np.errstate(divide="ignore", invalid="ignore"):
            return uvw[:, :2] / uvw[:, 2:], uvw[:, 2]


@dataclass(frozen=True)
class Pose:
    name: str  # of the image file; names sort in the order of the views
    world_to_camera: np.ndarray  # (4, 4) float64, COLMAP frame

    @property
    def centre(self) -> np.ndarray:
        """(3,) world, metres."""
        return -self.world_to_camera[:3, :3].T @ self.world_to_camera[:3, 3]


def pose(number: int, eye: np.ndarray, target: np.ndarray, roll: float = 0.0) -> Pose:
    """The view of this number, from `eye` towards `target`, turned clockwise by `roll` radians around its
    viewing axis."""
    turned = np.eye(4)
    turned[:2, :2] = [[np.cos(roll), np.sin(roll)], [-np.sin(roll), np.cos(roll)]]
    return Pose(f"{number:04d}.png", turned @ look_at(np.array(eye), np.array(target)))


def look_at(eye: np.ndarray, target: np.ndarray) -> np.ndarray:
    """World-to-camera (4, 4) with x right, y down, z towards the target; world z is up."""
    forward = (target - eye) / np.linalg.norm(target - eye)
    right = np.cross(forward, [0.0, 0.0, 1.0])
    right /= np.linalg.norm(right)
    pose = np.eye(4)
    pose[:3, :3] = right, np.cross(forward, right), forward
    pose[:3, 3] = -pose[:3, :3] @ eye
    return pose
