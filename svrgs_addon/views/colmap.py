"""Finds, checks and reads COLMAP sparse models with pycolmap, and makes a pinhole camera of every camera.

pycolmap is imported inside functions only, and not for pinhole cameras of a transforms.json. It reads a
checked copy of cameras, images and points3D (colmap_files.py): the poses are in `images`, and the files of
rigs and frames are not needed for pinhole views.
"""

from __future__ import annotations

import functools
import itertools
import signal
import sys
import tempfile
import threading
from pathlib import Path
from types import ModuleType
from typing import TYPE_CHECKING

import numpy as np

from ..files.images import MAX_SIDE
from ..files.reading import readable
from ..scene.camera import Camera
from ..system import packages
from ..system.errors import FormatError, SceneError
from ..system.foreign import check_name
from .colmap_files import copy_checked, has_files
from .sparse_model import Intrinsics, Model, View

if TYPE_CHECKING:
    import pycolmap

MODEL_FOLDERS = (".", "sparse/0", "0", "sparse")  # searched below the given folder, in this order
ROUNDING_PX = 1.0  # tolerance of each side of a scaled photograph
UNUSABLE = (
    "its camera has a focal length or pose that is not usable; remove the view from the model, or run COLMAP"
    " again"
)


def find_model(folder: Path) -> Path:
    """The folder with the three files of the model: `folder`, one of MODEL_FOLDERS below it, or the only
    sparse/N. Raises SceneError if there is none, FormatError if there are several sparse/N but no
    sparse/0."""
    for below in MODEL_FOLDERS:
        if _has_model(folder / below):
            return folder / below
    numbered = [found for found in sorted((folder / "sparse").glob("[0-9]*")) if _has_model(found)]
    if len(numbered) > 1:
        raise FormatError(
            f"{folder}: holds several models, but no sparse/0; name one of {', '.join(map(str, numbered))}"
        )
    if numbered:
        return numbered[0]
    raise SceneError(
        f"{folder}: holds no COLMAP model (cameras, images and points3D as .bin or .txt, here or in sparse/0)"
    )


def _has_model(folder: Path) -> bool:
    return has_files(folder, ".bin") or has_files(folder, ".txt")


def read_model(folder: Path) -> Model:
    """Reads the model in `folder`: its binary files, else the text files. Raises FormatError."""
    library = import_pycolmap()
    with readable(folder):
        try:
            with tempfile.TemporaryDirectory() as temp_dir:
                names = copy_checked(folder, Path(temp_dir), _param_count)
                return _convert(library.Reconstruction(temp_dir), names)
        except FormatError as error:
            raise FormatError(f"{folder}: {error}") from None
        except (ValueError, LookupError, RuntimeError, MemoryError) as error:
            # without the position in pycolmap's source code
            reason = str(error).partition("\n")[0].rpartition("] ")[2]
            raise FormatError(f"{folder}: is not a COLMAP model that can be read ({reason})") from error


def pinhole_camera(view: View, width: int, height: int) -> tuple[Camera, pycolmap.Camera | None]:
    """The pinhole camera of a view for a photograph of width x height pixels, and its distorted camera at
    that size or None.

    The pinhole of a distorted view has the size and K of the image that undistort_image returns. Raises
    SceneError if the photograph has another aspect ratio than the camera, or if no pinhole can be made of the
    camera model.
    """
    _check_aspect(view, width, height)
    if not (np.isfinite(view.camera.params).all() and np.isfinite(view.viewmat).all()):
        raise SceneError(f"{view.name}: {UNUSABLE}")
    K = view.camera.pinhole()
    if K is not None:
        camera = Camera(view.viewmat, K, view.camera.width, view.camera.height, view.name)
        return _checked_camera(camera.resized(width, height)), None
    distorted, flat = _undistort_camera(view.camera, (width, height))
    if flat is None:
        raise SceneError(
            f"{view.name}: its camera model is {view.camera.model}, a panorama, which is not supported; cut"
            " it into perspective views first"
        )
    camera = Camera(view.viewmat, flat.calibration_matrix(), flat.width, flat.height, view.name)
    return _checked_camera(camera), distorted


def undistort_image(pixels: np.ndarray, distorted: pycolmap.Camera) -> np.ndarray:
    """Resamples a photograph (H, W, 3) uint8 bilinearly to (H', W', 3) of its pinhole camera."""
    library = import_pycolmap("undistorting photographs")
    bitmap = library.Bitmap.from_array(pixels)
    return library.undistort_image(library.UndistortCameraOptions(), bitmap, distorted)[0].to_array()


def import_pycolmap(purpose: str = "reading a COLMAP model, unlike a transforms.json,") -> ModuleType:
    """pycolmap. purpose: subject of the sentence if it is missing. The handler of SIGTERM stays as it was.
    Raises SceneError if it is not installed, NativeError if it cannot be loaded."""
    before = None if "pycolmap" in sys.modules else signal.getsignal(signal.SIGTERM)
    library = packages.load("pycolmap", purpose)
    if before is not None and threading.current_thread() is threading.main_thread():
        signal.signal(signal.SIGTERM, before)  # the import installs a handler that prints a stack trace
    return library


def _convert(reconstruction: pycolmap.Reconstruction, names: dict[int, str]) -> Model:
    """The model with the images that have a pose. names: of all images, by image id. Raises FormatError."""
    images = [(names[image.image_id], image) for image in reconstruction.images.values() if image.has_pose]
    images.sort(key=lambda pair: pair[0])
    twice = next((a for (a, _), (b, _) in itertools.pairwise(images) if a == b), None)
    if twice is not None:
        raise FormatError(
            f"names the photograph {twice!r} twice; remove one of the two images, or export the model again"
        )
    points = [point for _, point in sorted(reconstruction.points3D.items())]
    positions = np.array([point.xyz for point in points], np.float64).reshape(-1, 3)
    if not (np.abs(positions) < np.finfo(np.float32).max).all():
        raise FormatError("has a 3-D point that is not at a finite place; run COLMAP's mapper again")
    return Model(
        views=[_view(name, image) for name, image in images],
        points=positions.astype(np.float32),
        point_colors=np.array([point.color for point in points], np.uint8).reshape(-1, 3),
    )


def _view(name: str, image: pycolmap.Image) -> View:
    """The view of an image with a pose. Raises FormatError for a forbidden name or image size."""
    check_name(name, "image")
    assert image.camera is not None
    width, height = image.camera.width, image.camera.height
    if not (0 < width <= MAX_SIDE and 0 < height <= MAX_SIDE):  # undistorting visits every border pixel
        raise FormatError(f"the camera of {name} is {width} x {height}; the limit is {MAX_SIDE} per side")
    viewmat = np.eye(4)
    viewmat[:3] = image.cam_from_world().matrix()
    return View(name, viewmat, Intrinsics(image.camera.model_name, width, height, tuple(image.camera.params)))


@functools.lru_cache(maxsize=256)  # most views of a dataset share a camera
def _undistort_camera(
    camera: Intrinsics, scaled: tuple[int, int]
) -> tuple[pycolmap.Camera, pycolmap.Camera | None]:
    """The distorted camera at the scaled (width, height), and COLMAP's pinhole of it; None of a panorama."""
    library = import_pycolmap("undistorting photographs")
    distorted = library.Camera(**vars(camera))
    if not distorted.is_perspective():
        return distorted, None
    distorted.rescale(*scaled)
    return distorted, library.undistort_camera(library.UndistortCameraOptions(), distorted)


def _checked_camera(camera: Camera) -> Camera:
    """Returns the camera. Raises SceneError if its pose or intrinsics are not usable."""
    if not camera.usable:
        raise SceneError(f"{camera.name}: {UNUSABLE}")
    return camera


def _check_aspect(view: View, width: int, height: int) -> None:
    """Raises SceneError unless the photograph is a scaled copy, up to ROUNDING_PX per side."""
    sides = ((width, view.camera.width), (height, view.camera.height))
    smallest = max((side - ROUNDING_PX) / full for side, full in sides)
    largest = min((side + ROUNDING_PX) / full for side, full in sides)
    if smallest > largest:
        raise SceneError(
            f"{view.name}: the photograph is {width} x {height}, which is no scaled copy of its camera's"
            f" {view.camera.width} x {view.camera.height}"
        )


def _param_count(model: int) -> int:
    """The number of parameters of a camera model, given by COLMAP's number. Raises ValueError."""
    library = import_pycolmap()
    return len(library.Camera.create_from_model_id(0, library.CameraModelId(model), 1.0, 1, 1).params)
