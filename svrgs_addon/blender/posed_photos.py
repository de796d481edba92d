"""A COLMAP dataset for Blender: pinhole cameras, undistorted photographs, sparse points.

It is read in a child process, because pycolmap cannot be imported into every Blender. The child process is
`python -m svrgs_addon.blender.posed_photos`. It gets {folder, images, undistorted, out} as JSON on stdin, writes the dataset to the
file `out`, and prints {} or {"error": sentence} on stdout.
"""

from __future__ import annotations

import sys
import tempfile
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from ..camera import Camera
from ..errors import SceneError, SplatError
from ..exit_status import answer
from . import subprocess_python


@dataclass(frozen=True)
class PosedPhotos:
    """Views in the order of image names, and sparse points, in the COLMAP world."""

    cameras: list[Camera]
    files: list[Path | None]  # photographs of the pinhole cameras; None: there is none
    points: np.ndarray  # (P, 3) float32
    point_colors: np.ndarray  # (P, 3) uint8, RGB
    warning: str = ""

    @property
    def extent(self) -> float:
        """Diagonal of the bounding box of all camera positions, in world units."""
        return float(np.linalg.norm(np.ptp([camera.position for camera in self.cameras], axis=0)))


def read_in_child(folder: Path, images: str = "", undistorted: Path | None = None) -> PosedPhotos:
    """Reads the dataset in `folder` in a child process. images: name or path of the image folder, "" for the default.

    undistorted: folder for undistorted copies of photographs that have distortion; writing them takes time. None: views with
    distortion have no file. If the photographs cannot be found or read, the result has only cameras and points, and a warning.
    Raises SceneError.
    """
    with tempfile.TemporaryDirectory() as temp_dir:
        out = Path(temp_dir) / "photos.npz"
        request = {"folder": str(folder), "images": images, "undistorted": str(undistorted or ""), "out": str(out)}
        status, result = subprocess_python.run([], "svrgs_addon.blender.posed_photos", request)
        if status or not out.exists():
            raise SceneError(result.get("error", f"{folder}: reading it failed"))
        return _unpack(out)


def read(folder: Path, images: str, undistorted: Path | None) -> PosedPhotos:
    """As read_in_child, but in this process. Raises SceneError, FormatError."""
    from ..photographs.dataset import load_dataset

    warning = ""
    try:
        dataset = load_dataset(folder, images or None)
    except SplatError as error:
        dataset = load_dataset(folder, cameras_only=True)  # this fails too if the model is the cause
        warning = f"{error}; the cameras were loaded without photographs"
    files = [_pinhole_photo(dataset, i, undistorted) for i in range(len(dataset.photos))] or [None] * len(dataset.cameras)
    return PosedPhotos(dataset.cameras, files, dataset.points, dataset.point_colors, warning)


def _pinhole_photo(dataset, index: int, undistorted: Path | None) -> Path | None:
    """The photograph, or its undistorted copy, which is written if it is missing or older than the photograph."""
    from ..files.images import write_image

    photo = dataset.photos[index]
    if photo.distorted is None:
        return photo.path.absolute()
    if undistorted is None:
        return None
    target = undistorted.absolute() / f"{dataset.cameras[index].name}.png"
    if not target.exists() or target.stat().st_mtime < photo.path.stat().st_mtime:
        write_image(target, dataset.image(index))
    return target


def _pack(path: Path, photos: PosedPhotos):
    """Writes the dataset to an .npz file for the parent process."""
    cameras = photos.cameras
    np.savez(
        path, viewmats=[c.viewmat for c in cameras], Ks=[c.K for c in cameras], sizes=[(c.width, c.height) for c in cameras],
        names=[c.name for c in cameras], files=[str(file or "") for file in photos.files],
        points=photos.points, point_colors=photos.point_colors, warning=photos.warning,
    )  # fmt: skip


def _unpack(path: Path) -> PosedPhotos:
    """Reads the file of _pack."""
    with np.load(path) as data:
        views = zip(data["viewmats"], data["Ks"], data["sizes"], data["names"], strict=True)
        cameras = [Camera(viewmat, K, int(size[0]), int(size[1]), str(name)) for viewmat, K, size, name in views]
        files = [Path(str(file)) if file else None for file in data["files"]]
        return PosedPhotos(cameras, files, data["points"], data["point_colors"], str(data["warning"]))


def _read_request(request: dict) -> dict:
    undistorted = Path(request["undistorted"]) if request["undistorted"] else None
    _pack(Path(request["out"]), read(Path(request["folder"]), request["images"], undistorted))
    return {}


if __name__ == "__main__":
    sys.exit(answer(_read_request))
