"""Where the cameras stand. Plain NumPy: no Blender here."""

from dataclasses import dataclass

import numpy as np

MIDDLE = np.array([0.0, 0.0, 0.75])  # metres; what every camera looks at, give or take

# Share of the views, distance from the axis (m), height (m), both with their jitter.
RINGS = (
    (0.40, (4.6, 0.25), (1.25, 0.25)),
    (0.33, (4.1, 0.25), (2.75, 0.25)),
    (0.27, (2.95, 0.15), (1.45, 0.45)),
)


@dataclass(frozen=True)
class Intrinsics:
    """A pinhole in pixels; pixel centres lie at k + 0.5."""

    width: int
    height: int
    focal: float

    @classmethod
    def for_size(cls, width: int, height: int) -> "Intrinsics":
        return cls(width, height, 0.9 * width)  # 58 degrees across

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


def look_at(eye: np.ndarray, target: np.ndarray) -> np.ndarray:
    """World-to-camera (4, 4) with x right, y down, z towards the target; world z is up."""
    forward = (target - eye) / np.linalg.norm(target - eye)
    right = np.cross(forward, [0.0, 0.0, 1.0])
    right /= np.linalg.norm(right)
    pose = np.eye(4)
    pose[:3, :3] = right, np.cross(forward, right), forward
    pose[:3, 3] = -pose[:3, :3] @ eye
    return pose


def rings(count: int) -> list[Pose]:
    """`count` poses on three rings around the middle.

    Names run around each ring in turn, so every 8th one, the test split, falls all round the
    scene at every height.
    """
    rng = np.random.default_rng(20)
    shares = np.cumsum([0.0] + [share for share, _, _ in RINGS])
    edges = np.rint(shares / shares[-1] * count).astype(int)
    poses = []
    for ring, (_, radius, height) in enumerate(RINGS):
        size = edges[ring + 1] - edges[ring]
        for step in range(size):
            jitter = rng.uniform(-1, 1, 6)
            angle = 2 * np.pi * (step + 0.2 * jitter[0] + 0.37 * ring) / size
            away = radius[0] + radius[1] * jitter[1]
            eye = [away * np.cos(angle), away * np.sin(angle), height[0] + height[1] * jitter[2]]
            target = MIDDLE + 0.15 * jitter[3:]
            poses.append(Pose(f"{len(poses):04d}.png", look_at(np.array(eye), target)))
    return poses
