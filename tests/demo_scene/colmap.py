"""Writes a COLMAP binary model. Written out by hand so that making data needs only Blender.

Layout: https://colmap.github.io/format.html (cameras.bin, images.bin, points3D.bin).
"""

import struct
from pathlib import Path

import numpy as np

from demo_scene.points import Cloud
from demo_scene.views import Intrinsics, Pose

PINHOLE = 1
CAMERA_ID = 1


def write_model(folder: Path, camera: Intrinsics, poses: list[Pose], cloud: Cloud) -> None:
    """Write the three files; image k of `poses` gets id k + 1, point k of the cloud id k + 1."""
    folder.mkdir(parents=True)
    (folder / "cameras.bin").write_bytes(_cameras(camera))
    (folder / "images.bin").write_bytes(_images(poses, cloud))
    (folder / "points3D.bin").write_bytes(_points(len(poses), cloud))


def quat_wxyz(rotation: np.ndarray) -> np.ndarray:
    """Unit quaternion (4,), w >= 0, of a rotation matrix (3, 3)."""
    r = rotation
    # The quaternion is the top eigenvector of this matrix (Bar-Itzhack): no case is special.
    k = np.array(
        [
            [r[0, 0] + r[1, 1] + r[2, 2], 0, 0, 0],
            [r[2, 1] - r[1, 2], r[0, 0] - r[1, 1] - r[2, 2], 0, 0],
            [r[0, 2] - r[2, 0], r[1, 0] + r[0, 1], r[1, 1] - r[0, 0] - r[2, 2], 0],
            [r[1, 0] - r[0, 1], r[2, 0] + r[0, 2], r[2, 1] + r[1, 2], r[2, 2] - r[0, 0] - r[1, 1]],
        ]
    )
    quat = np.linalg.eigh(k, UPLO="L")[1][:, -1]
    return quat if quat[0] >= 0 else -quat


def _cameras(camera: Intrinsics) -> bytes:
    head = struct.pack("<QiiQQ", 1, CAMERA_ID, PINHOLE, camera.width, camera.height)
    centre = camera.width / 2, camera.height / 2
    return head + struct.pack("<4d", camera.focal, camera.focal, *centre)


def _images(poses: list[Pose], cloud: Cloud) -> bytes:
    parts = [struct.pack("<Q", len(poses))]
    for index, pose in enumerate(poses):
        seen = cloud.view == index
        pose_values = *quat_wxyz(pose.world_to_camera[:3, :3]), *pose.world_to_camera[:3, 3]
        parts.append(struct.pack("<I7dI", index + 1, *pose_values, CAMERA_ID))
        parts.append(pose.name.encode() + b"\0" + struct.pack("<Q", seen.sum()))
        keypoints = np.zeros(seen.sum(), dtype=[("xy", "<f8", 2), ("point", "<u8")])
        keypoints["xy"] = cloud.xy[seen]
        keypoints["point"] = cloud.point[seen] + 1
        parts.append(keypoints.tobytes())
    return b"".join(parts)


def _points(view_count: int, cloud: Cloud) -> bytes:
    tracks: list[list[int]] = [[] for _ in cloud.xyz]
    for index in range(view_count):  # a keypoint's number is its place within its image
        for keypoint, point in enumerate(cloud.point[cloud.view == index]):
            tracks[point] += [index + 1, keypoint]
    parts = [struct.pack("<Q", len(cloud.xyz))]
    for index, (xyz, rgb, track) in enumerate(zip(cloud.xyz, cloud.rgb, tracks, strict=True)):
        # The error is 0: keypoints are the projections themselves.
        parts.append(struct.pack("<Q3d3Bd", index + 1, *xyz, *rgb, 0.0))
        parts.append(struct.pack(f"<Q{len(track)}I", len(track) // 2, *track))
    return b"".join(parts)
