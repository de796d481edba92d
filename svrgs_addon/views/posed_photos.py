"""A dataset for Blender: pinhole cameras, undistorted photographs, sparse points.

It is read in a child process, because pycolmap cannot be imported into every Blender. The child process is
`python -m svrgs_addon.views.posed_photos`. It gets {folder, images, undistorted, out} as JSON on stdin,
writes the dataset to the file `out`, and prints {} or {"error": sentence} on stdout. While it undistorts, it
prints {"progress": [photographs done, photographs to undistort]} after each.
"""

from __future__ import annotations

import json
import sys
import tempfile
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from ..scene.camera import Camera
from ..system import subprocess_python
from ..system.errors import FormatError, SplatError
from ..system.exit_status import answer

Progress = Callable[[int, int], None]  # (photographs done, photographs to undistort)


@dataclass(frozen=True)
class PosedPhotos:
    """Views in the order of image names, and sparse points, in the world of the dataset."""

    cameras: list[Camera]
    files: list[Path | None]  # photographs of the pinhole cameras; None: there is none
    points: np.ndarray  # (P, 3) float32
    point_colors: np.ndarray  # (P, 3) uint8, RGB
    distorted: int = 0  # photographs that must be undistorted before they can be shown
    warnings: tuple[str, ...] = ()  # sentences on what is missing

    @property
    def extent(self) -> float:
        """Diagonal of the bounding box of all camera positions, in world units."""
        return float(np.linalg.norm(np.ptp([camera.position for camera in self.cameras], axis=0)))


def read_in_child(
    folder: Path, images: str = "", undistorted: Path | None = None, progress: Progress = lambda *_: None
) -> PosedPhotos:
    """Reads the dataset in `folder` in a child process. images: name or path of the image folder, "" for the
    default.

    undistorted: folder for undistorted copies of photographs that have distortion; writing them takes time,
    and progress() is called after each. None: views with distortion have no file. If the photographs cannot
    be found or read, the result has only cameras and points, and a warning. Raises SceneError.
    """
    with tempfile.TemporaryDirectory() as temp_dir:
        out = Path(temp_dir) / "photos.npz"
        request = {"folder": str(folder), "images": images, "undistorted": str(undistorted or "")}
        subprocess_python.ask(
            [], "svrgs_addon.views.posed_photos", request | {"out": str(out)}, progress=progress
        )
        return _unpack(out)


def read(
    folder: Path, images: str, undistorted: Path | None, progress: Progress = lambda *_: None
) -> PosedPhotos:
    """As read_in_child, but in this process. Raises SceneError, FormatError."""
    from .dataset import load_dataset
    from .valid_pixels import MaskOptions

    try:
        dataset = load_dataset(folder, images or None, masks=MaskOptions(used=False))
        warnings = [*dataset.notes]
    except SplatError as error:
        dataset = load_dataset(folder, cameras_only=True)  # this fails too if the model is the cause
        warnings = [*dataset.notes, f"{error}; the cameras were loaded without photographs"]
    distorted = sum(photo.distorted is not None for photo in dataset.photos)
    files: list[Path | None] = [] if dataset.photos else [None] * len(dataset.cameras)
    changed, done = _changed(folder), 0
    for index, photo in enumerate(dataset.photos):
        try:
            files.append(_pinhole_photo(dataset, index, undistorted, changed))
        except FormatError as error:  # a damaged photograph
            files.append(None)
            warnings.append(f"{error}; it is not shown")
        if undistorted is not None and photo.distorted is not None:
            done += 1
            progress(done, distorted)
    return PosedPhotos(
        dataset.cameras, files, dataset.points, dataset.point_colors, distorted, tuple(warnings)
    )


def _changed(folder: Path) -> float:
    """When the lenses of a dataset were written last, in seconds."""
    from .sources import find_cameras

    location, is_model = find_cameras(folder)
    files = [one for one in location.iterdir() if one.stem == "cameras"] if is_model else [location]
    return max((one.stat().st_mtime for one in files), default=0.0)


def _pinhole_photo(dataset, index: int, undistorted: Path | None, changed: float) -> Path | None:
    """The photograph, or its undistorted copy, which is written if it is missing, or older than the
    photograph or the lenses (changed). Raises FormatError if the photograph is damaged; SceneError if the
    copy cannot be written."""
    from ..files.images import write_image

    photo = dataset.photos[index]
    if photo.distorted is None:
        return photo.path.absolute()
    if undistorted is None:
        return None
    target = undistorted.absolute() / f"{dataset.cameras[index].name}.png"
    if not target.exists() or target.stat().st_mtime < max(changed, photo.path.stat().st_mtime):
        write_image(target, dataset.image(index))
    return target


def _pack(path: Path, photos: PosedPhotos):
    """Writes the dataset to an .npz file for the parent process."""
    cameras = photos.cameras
    np.savez(
        path,
        viewmats=[c.viewmat for c in cameras],
        Ks=[c.K for c in cameras],
        sizes=[(c.width, c.height) for c in cameras],
        names=[c.name for c in cameras],
        files=[str(file or "") for file in photos.files],
        points=photos.points,
        point_colors=photos.point_colors,
        distorted=photos.distorted,
        warnings=photos.warnings,
    )


def _unpack(path: Path) -> PosedPhotos:
    """Reads the file of _pack."""
    with np.load(path) as data:
        views = zip(data["viewmats"], data["Ks"], data["sizes"], data["names"], strict=True)
        cameras = [
            Camera(viewmat, K, int(size[0]), int(size[1]), str(name)) for viewmat, K, size, name in views
        ]
        files = [Path(str(file)) if file else None for file in data["files"]]
        warnings = tuple(str(sentence) for sentence in data["warnings"])
        points, colors = data["points"], data["point_colors"]
        return PosedPhotos(cameras, files, points, colors, int(data["distorted"]), warnings)


def _read_request(request: dict) -> dict:
    undistorted = Path(request["undistorted"]) if request["undistorted"] else None
    progress = lambda done, total: print(json.dumps({"progress": [done, total]}), flush=True)
    _pack(Path(request["out"]), read(Path(request["folder"]), request["images"], undistorted, progress))
    return {}


if __name__ == "__main__":
    sys.exit(answer(_read_request))
