"""A COLMAP dataset for Blender: pinhole cameras, photographs that fit them, sparse points. Read in a child: pycolmap cannot be
imported into every Blender.

Child: `python -m svrgs_addon.blender.posed_photos`, {folder, images, undistorted, out} as JSON on stdin; {} or {"error": sentence} on stdout.
"""

from __future__ import annotations

import json
import sys
import tempfile
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from ..camera import Camera
from ..errors import SceneError, SplatError
from ..exit_status import guarded
from . import subprocess_python


@dataclass(frozen=True)
class PosedPhotos:
    """Views in image-name order, COLMAP's world."""

    cameras: list[Camera]
    files: list[Path | None]  # photographs as the pinholes see them; None where there is none
    points: np.ndarray  # (P, 3) float32
    point_colors: np.ndarray  # (P, 3) uint8
    warning: str = ""

    @property
    def extent(self) -> float:
        """Diagonal of the box around all cameras."""
        return float(np.linalg.norm(np.ptp([camera.position for camera in self.cameras], axis=0)))


def read_in_child(folder: Path, images: str = "", undistorted: Path | None = None) -> PosedPhotos:
    """The dataset in `folder`. undistorted: where photographs of lenses with distortion are written as their pinholes see them, which
    takes its time; None: these have no file.

    Without photographs there are cameras alone, and a warning. Raises SceneError.
    """
    with tempfile.TemporaryDirectory() as aside:
        out = Path(aside) / "photos.npz"
        request = {"folder": str(folder), "images": images, "undistorted": str(undistorted or ""), "out": str(out)}
        status, result = subprocess_python.run([], "svrgs_addon.blender.posed_photos", request)
        if status or not out.exists():
            raise SceneError(result.get("error", f"{folder}: reading it failed"))
        return _unpack(out)


def read(folder: Path, images: str, undistorted: Path | None) -> PosedPhotos:
    """As read_in_child, in this process."""
    from ..photographs.dataset import load_dataset

    warning = ""
    try:
        dataset = load_dataset(folder, images or None)
    except SplatError as error:
        dataset = load_dataset(folder, cameras_only=True)  # if the model is at fault, this fails as well
        warning = f"{error}; the cameras came without photographs"
    files = [_fitting(dataset, i, undistorted) for i in range(len(dataset.photos))] or [None] * len(dataset.cameras)
    return PosedPhotos(dataset.cameras, files, dataset.points, dataset.point_colors, warning)


def _fitting(dataset, index: int, undistorted: Path | None) -> Path | None:
    """The photograph's file, or the file of it undistorted, which is written unless a newer one is there."""
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
    cameras = photos.cameras
    np.savez(
        path, viewmats=[c.viewmat for c in cameras], Ks=[c.K for c in cameras], sizes=[(c.width, c.height) for c in cameras],
        names=[c.name for c in cameras], files=[str(file or "") for file in photos.files],
        points=photos.points, point_colors=photos.point_colors, warning=photos.warning,
    )  # fmt: skip


def _unpack(path: Path) -> PosedPhotos:
    with np.load(path) as data:
        views = zip(data["viewmats"], data["Ks"], data["sizes"], data["names"], strict=True)
        cameras = [Camera(viewmat, K, int(size[0]), int(size[1]), str(name)) for viewmat, K, size, name in views]
        files = [Path(str(file)) if file else None for file in data["files"]]
        return PosedPhotos(cameras, files, data["points"], data["point_colors"], str(data["warning"]))


def main() -> int:
    request = json.load(sys.stdin)
    result: dict = {}

    def work() -> int:
        undistorted = Path(request["undistorted"]) if request["undistorted"] else None
        _pack(Path(request["out"]), read(Path(request["folder"]), request["images"], undistorted))
        return 0

    status = guarded(work, lambda sentence: result.update(error=sentence))
    print(json.dumps(result), flush=True)
    return status


if __name__ == "__main__":
    sys.exit(main())
