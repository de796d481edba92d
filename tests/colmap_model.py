"""COLMAP models of given cameras."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pycolmap

from svrgs_addon.scene.camera import Camera


def write_colmap(folder: Path, cameras: list[Camera], points: np.ndarray, model: str = "PINHOLE"):
    """A binary COLMAP model of views that share one camera."""
    result = pycolmap.Reconstruction()
    first = cameras[0]
    params = (
        [first.K[0, 0], first.K[1, 1], first.K[0, 2], first.K[1, 2]]
        if model == "PINHOLE"
        else [first.width, first.height]
    )
    camera = pycolmap.Camera(camera_id=1, model=model, width=first.width, height=first.height, params=params)
    result.add_camera_with_trivial_rig(camera)
    for number, view in enumerate(cameras, 1):
        pose = pycolmap.Rigid3d(pycolmap.Rotation3d(view.viewmat[:3, :3]), view.viewmat[:3, 3])
        result.add_image_with_trivial_frame(
            pycolmap.Image(name=view.name, camera_id=1, image_id=number), pose
        )
    for point in points.astype(np.float64):
        result.add_point3D(point, pycolmap.Track(), np.array([200, 150, 100], np.uint8))
    folder.mkdir(parents=True, exist_ok=True)
    result.write_binary(folder)
