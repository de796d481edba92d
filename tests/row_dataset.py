"""Datasets of cameras in a row, with random photographs."""

from __future__ import annotations

import numpy as np
import pycolmap

from svrgs_addon.files.images import write_image

WIDTH, HEIGHT = 64, 48
PINHOLE = ("PINHOLE", [60.0, 58.0, 30.5, 25.0])
OPENCV = ("OPENCV", [60.0, 58.0, 31.0, 25.0, -0.1, 0.02, 0.002, -0.001])
POINTS = np.array([[0.1, 0.2, 0.0], [-0.4, 0.3, 0.5], [0.6, -0.2, 0.2]])


def photo(index: int, width: int = WIDTH, height: int = HEIGHT) -> np.ndarray:
    return np.random.default_rng(index).integers(0, 256, (height, width, 3), dtype=np.uint8)


def make_model(names, model=PINHOLE, points=POINTS) -> pycolmap.Reconstruction:
    """Cameras in a row, 4 units in front of the origin, slightly turned; ids run against the name order."""
    result = pycolmap.Reconstruction()
    camera = pycolmap.Camera(camera_id=1, model=model[0], width=WIDTH, height=HEIGHT, params=model[1])
    result.add_camera_with_trivial_rig(camera)
    for index, name in enumerate(names):
        pose = pycolmap.Rigid3d(
            pycolmap.Rotation3d(np.array([0, 0.02 * index, 0])), np.array([0.1 * index, 0.0, 4.0])
        )
        image = pycolmap.Image(name=name, camera_id=1, image_id=len(names) - index)
        result.add_image_with_trivial_frame(image, pose)
    for point in points:
        result.add_point3D(point, pycolmap.Track(), np.array([10, 20, 30], np.uint8))
    return result


def make_dataset(
    root,
    names=None,
    model=PINHOLE,
    points=POINTS,
    text=False,
    below="sparse/0",
    images="images",
    size=(WIDTH, HEIGHT),
):
    """Write photographs and model; returns the reconstruction."""
    names = names or [f"{i:02}.png" for i in range(9)]
    reconstruction = make_model(names, model, points)
    (root / below).mkdir(parents=True, exist_ok=True)
    (reconstruction.write_text if text else reconstruction.write_binary)(root / below)
    for index, name in enumerate(names):
        write_image(root / images / name, photo(index, *size))
    return reconstruction


def only_the_three_files(folder):
    for path in folder.iterdir():
        if path.stem in ("rigs", "frames"):
            path.unlink()
