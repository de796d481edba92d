"""COLMAP sparse models through pycolmap: finding, checking, reading, and turning every camera into a pinhole.

pycolmap is imported inside functions only. It trusts the counts in binary files (a cut points3D.bin makes it loop for
ever), so these are held against the bytes that exist before it sees them; and it sees no file but those three, since
poses stand in `images` and rigs and frames add nothing a pinhole view needs.
"""

from __future__ import annotations

import copy
import functools
import os
import shutil
import signal
import struct
import sys
import tempfile
import threading
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path, PurePosixPath, PureWindowsPath
from types import ModuleType
from typing import TYPE_CHECKING

import numpy as np

from ..camera import Camera
from ..errors import FormatError, SceneError
from ..files.images import MAX_SIDE

if TYPE_CHECKING:
    import pycolmap

MODEL_FILES = ("cameras", "images", "points3D")
MODEL_FOLDERS = (".", "sparse/0", "0", "sparse")  # below the folder given
ROUNDING_PX = 1.0  # by which a scaled photograph's sides may miss the exact ratio


@dataclass(frozen=True)
class View:
    """One registered photograph."""

    name: str  # '/' between folders
    viewmat: np.ndarray  # (4, 4) float64, world to camera
    camera: pycolmap.Camera  # of any model, at the size of the photograph COLMAP saw


@dataclass(frozen=True)
class Model:
    """A sparse model: views in name order; points (P, 3) float32 world; point_colors (P, 3) uint8 RGB."""

    views: list[View]
    points: np.ndarray
    point_colors: np.ndarray


def find_model(folder: Path) -> Path:
    """The folder of the model's three files: `folder` itself or below. Raises SceneError."""
    for below in MODEL_FOLDERS:
        if _has_files(folder / below, ".bin") or _has_files(folder / below, ".txt"):
            return folder / below
    raise SceneError(f"{folder}: holds no COLMAP model (cameras, images and points3D as .bin or .txt, here or in sparse/0)")


def read_model(folder: Path) -> Model:
    """Read the model in `folder`, binary if it is there, else text. Raises FormatError."""
    library = import_pycolmap()
    suffix = ".bin" if _has_files(folder, ".bin") else ".txt"
    try:
        if suffix == ".bin":
            for name, skip in zip(MODEL_FILES, (_skip_camera, _skip_image, _skip_point), strict=True):
                _check_records(folder / f"{name}.bin", skip)
        with tempfile.TemporaryDirectory() as alone:
            for name in MODEL_FILES:
                _lend(folder / f"{name}{suffix}", Path(alone))
            return _convert(library.Reconstruction(alone))
    except FormatError as error:
        raise FormatError(f"{folder}: {error}") from None
    except OSError as error:
        raise FormatError(f"{folder}: cannot be read ({error.strerror or error})") from error
    except (ValueError, LookupError, RuntimeError, MemoryError) as error:
        reason = str(error).partition("\n")[0].rpartition("] ")[2]  # without pycolmap's source line
        raise FormatError(f"{folder}: is not a COLMAP model that can be read ({reason})") from error


def pinhole_camera(view: View, width: int, height: int) -> tuple[Camera, pycolmap.Camera | None]:
    """The view as a pinhole for its photograph of width x height, and the distorted camera at that size, if it is one.

    A distorted view's pinhole has the size and K that undistort_image gives. Raises SceneError where sizes disagree or
    the model cannot be undistorted.
    """
    _check_aspect(view, width, height)
    if not (np.isfinite(view.camera.params).all() and np.isfinite(view.viewmat).all()):
        raise SceneError(f"{view.name}: its camera has a focal length or pose that is not usable")
    kinds = import_pycolmap().CameraModelId
    if view.camera.model in (kinds.PINHOLE, kinds.SIMPLE_PINHOLE):
        full = Camera(view.viewmat, view.camera.calibration_matrix(), view.camera.width, view.camera.height, view.name)
        return _checked(full.resized(width, height)), None
    if not view.camera.is_perspective():
        raise SceneError(
            f"{view.name}: its camera model is {view.camera.model_name}, a panorama that no pinhole image can hold; cut it into perspective views first"
        )
    size = view.camera.width, view.camera.height
    distorted, flat = _undistort_camera(view.camera.model_name, size, tuple(view.camera.params), (width, height))
    return _checked(Camera(view.viewmat, flat.calibration_matrix(), flat.width, flat.height, view.name)), distorted


def undistort_image(pixels: np.ndarray, distorted: pycolmap.Camera) -> np.ndarray:
    """(H, W, 3) uint8 photograph of the distorted camera, resampled (bilinear) as its pinhole sees it."""
    library = import_pycolmap()
    bitmap = library.Bitmap.from_array(pixels)
    return library.undistort_image(library.UndistortCameraOptions(), bitmap, distorted)[0].to_array()


def check_name(name: str) -> None:
    """Refuse an image name that leads out of the image folder. Raises FormatError."""
    for path in (PurePosixPath(name), PureWindowsPath(name)):
        if not path.name or path.anchor or ".." in path.parts:
            raise FormatError(f"image name {name!r} does not stay inside the image folder")


def import_pycolmap() -> ModuleType:
    before = None if "pycolmap" in sys.modules else signal.getsignal(signal.SIGTERM)
    try:
        import pycolmap
    except ImportError as error:
        raise SceneError(f"reading COLMAP models needs the package pycolmap: run {sys.executable} -m pip install pycolmap") from error
    if before is not None and threading.current_thread() is threading.main_thread():
        signal.signal(signal.SIGTERM, before)  # the import put one there that prints a stack trace
    return pycolmap


def _has_files(folder: Path, suffix: str) -> bool:
    return all(os.path.isfile(folder / f"{name}{suffix}") for name in MODEL_FILES)


def _lend(file: Path, folder: Path) -> None:
    """Make the file appear in the folder: by a link, or by a copy where links are not allowed."""
    try:
        os.symlink(os.path.abspath(file), folder / file.name)
    except OSError:
        shutil.copyfile(file, folder / file.name)


def _convert(reconstruction: pycolmap.Reconstruction) -> Model:
    images = [image for image in reconstruction.images.values() if image.has_pose]
    points = [point for _, point in sorted(reconstruction.points3D.items())]
    positions = np.array([point.xyz for point in points], np.float64).reshape(-1, 3)
    if not (np.abs(positions) < np.finfo(np.float32).max).all():
        raise FormatError("has a 3-D point that is not at a finite place")
    return Model(
        views=[_view(image) for image in sorted(images, key=lambda image: image.name)],
        points=positions.astype(np.float32),
        point_colors=np.array([point.color for point in points], np.uint8).reshape(-1, 3),
    )


def _view(image: pycolmap.Image) -> View:
    check_name(image.name)
    assert image.camera is not None
    width, height = image.camera.width, image.camera.height
    if not (0 < width <= MAX_SIDE and 0 < height <= MAX_SIDE):  # undistorting walks along the border
        raise FormatError(f"the camera of {image.name} is {width} x {height}; the limit is {MAX_SIDE} a side")
    viewmat = np.eye(4)
    viewmat[:3] = image.cam_from_world().matrix()
    return View(image.name, viewmat, copy.copy(image.camera))


@functools.lru_cache(maxsize=256)  # the views of a dataset share few cameras
def _undistort_camera(model: str, size: tuple[int, int], params: tuple[float, ...], scaled: tuple[int, int]) -> tuple[pycolmap.Camera, pycolmap.Camera]:
    """The distorted camera at the scaled (width, height), and the pinhole COLMAP makes of it."""
    library = import_pycolmap()
    distorted = library.Camera(model=model, width=size[0], height=size[1], params=params)
    distorted.rescale(*scaled)
    return distorted, library.undistort_camera(library.UndistortCameraOptions(), distorted)


def _checked(camera: Camera) -> Camera:
    """Refuse what no image could be drawn with."""
    finite = np.isfinite(camera.K).all() and np.isfinite(camera.viewmat).all()
    if not (finite and camera.K[0, 0] > 0 and camera.K[1, 1] > 0):
        raise SceneError(f"{camera.name}: its camera has a focal length or pose that is not usable")
    return camera


def _check_aspect(view: View, width: int, height: int) -> None:
    """Both sides must be the camera's at one scale, up to rounding; else the photograph is not this model's."""
    sides = ((width, view.camera.width), (height, view.camera.height))
    smallest = max((side - ROUNDING_PX) / full for side, full in sides)
    largest = min((side + ROUNDING_PX) / full for side, full in sides)
    if smallest > largest:
        raise SceneError(
            f"{view.name}: the photograph is {width} x {height}, which is no scaled copy of its camera's {view.camera.width} x {view.camera.height}"
        )


def _check_records(path: Path, skip: Callable[[bytes, int], int]) -> None:
    """Walk over the records a binary file announces. Raises FormatError where they outrun its bytes."""
    data = path.read_bytes()
    try:
        (count,) = struct.unpack_from("<Q", data)
        position = 8
        for _ in range(count):
            position = skip(data, position)
        whole = position <= len(data)
    except (struct.error, ValueError, OverflowError):
        whole = False
    if not whole:
        raise FormatError(f"{path.name} is truncated or not a COLMAP file")


def _skip_camera(data: bytes, start: int) -> int:
    """id, model, width, height, then parameters by model."""
    _, model, _, _ = struct.unpack_from("<IiQQ", data, start)
    library = import_pycolmap()
    params = library.Camera.create_from_model_id(0, library.CameraModelId(model), 1.0, 1, 1).params
    return start + 24 + 8 * len(params)


def _skip_image(data: bytes, start: int) -> int:
    """id, pose, camera id, name ending in zero, then (x, y, point id) for each keypoint."""
    end = data.index(b"\0", start + 64) + 1
    (count,) = struct.unpack_from("<Q", data, end)
    return end + 8 + 24 * count


def _skip_point(data: bytes, start: int) -> int:
    """id, xyz, rgb, error, then (image id, keypoint) for each observation."""
    (count,) = struct.unpack_from("<Q", data, start + 43)
    return start + 51 + 8 * count
