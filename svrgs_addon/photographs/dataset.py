"""Posed photographs with their sparse points: what fine-tuning and evaluation look at.

Images are read when asked for, kept while they fit into a memory budget, and can be read ahead in the background.
"""

from __future__ import annotations

import itertools
import os
import threading
from collections import deque
from collections.abc import Callable, Generator, Iterable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from ..camera import Camera
from ..errors import SceneError
from ..files.images import image_size, read_pixels, to_bytes
from .cameras_json import load_cameras_json
from .colmap import View, find_model, pinhole_camera, read_model, undistort_image

if TYPE_CHECKING:
    import pycolmap

__all__ = ["Dataset", "load_cameras_json", "load_dataset"]

HOLDOUT = 8  # every 8th image in name order is for testing, as in 3DGS
EXTENT_MARGIN = 1.1
MEMORY_BUDGET = 4 * 2**30
READ_AHEAD = 3
READER_THREADS = 2
MISSING_SHOWN = 3


@dataclass(frozen=True)
class Photo:
    """Where a view's photograph is, and the distorted camera that took it, if it is not a pinhole's."""

    path: Path
    distorted: pycolmap.Camera | None


@dataclass
class Dataset:
    """Views in image-name order, after undistortion and scaling, and the sparse points in world coordinates."""

    cameras: list[Camera]
    points: np.ndarray  # (P, 3) float32
    point_colors: np.ndarray  # (P, 3) uint8
    train_indices: list[int]
    test_indices: list[int]
    photos: list[Photo] = field(default_factory=list)  # one a camera; empty where only cameras were asked for
    background: tuple[float, float, float] = (0, 0, 0)  # display sRGB, below transparent pixels
    memory_budget: int = MEMORY_BUDGET  # bytes
    _kept: dict[int, np.ndarray] = field(default_factory=dict, repr=False)
    _lock: threading.Lock = field(default_factory=threading.Lock, repr=False)

    @property
    def extent(self) -> float:
        """1.1 times the largest distance of a training camera from their mean, world units; of all if none trains."""
        centres = np.array([self.cameras[i].position for i in self.train_indices or range(len(self.cameras))])
        return float(EXTENT_MARGIN * np.linalg.norm(centres - centres.mean(axis=0), axis=1).max())

    def image(self, index: int) -> np.ndarray:
        """The photograph of cameras[index], (H, W, 3) display sRGB, read-only: uint8, or float32 in 0..1 where the file
        has more than 8 bits and needed no undistortion. Raises FormatError, SceneError.
        """
        with self._lock:
            image = self._kept.get(index)
        return self._read(index) if image is None else image

    def stream(self, order: Iterable, read: Callable | None = None, ahead: int = READ_AHEAD) -> Generator[tuple]:
        """(item, read(item)) for each item of `order`, which may be endless; threads read `ahead` of them in advance.

        read: by default image(), of indices. What comes out does not depend on the threads' timing. Close the iterator, or
        use it up, to end them.
        """
        read = read or self.image
        order = iter(order)
        pool = ThreadPoolExecutor(READER_THREADS)
        try:
            waiting = deque((item, pool.submit(read, item)) for item in itertools.islice(order, max(1, ahead)))
            while waiting:
                item, result = waiting.popleft()
                waiting.extend((item, pool.submit(read, item)) for item in itertools.islice(order, 1))
                yield item, result.result()
        finally:
            pool.shutdown(cancel_futures=True)

    def _read(self, index: int) -> np.ndarray:
        if not self.photos:
            raise SceneError("the dataset was loaded without its photographs")
        photo, camera = self.photos[index], self.cameras[index]
        image = read_pixels(photo.path, self.background, upright=False)  # COLMAP's pixels are those stored
        if photo.distorted is not None:
            image = undistort_image(to_bytes(image), photo.distorted)
        if image.shape != (camera.height, camera.width, 3):
            raise SceneError(f"{photo.path}: its size has changed since the dataset was loaded")
        image.flags.writeable = False
        self._keep(index, image)
        return image

    def _keep(self, index: int, image: np.ndarray) -> None:
        """Keep the image if it still fits. The first ones stay: in a random order no other choice serves better."""
        with self._lock:
            used = sum(kept.nbytes for kept in self._kept.values())
            if used + image.nbytes <= self.memory_budget:
                self._kept[index] = image


def load_dataset(
    folder: str | os.PathLike,
    images: str | None = None,
    *,
    holdout: int = HOLDOUT,
    background: tuple[float, float, float] = (0, 0, 0),
    cameras_only: bool = False,
    need_points: bool = False,
    memory_budget: int = MEMORY_BUDGET,
) -> Dataset:
    """Load a COLMAP dataset: its root, its `sparse`, `sparse/0`, or the folder of the model's files.

    images: the image folder ("images", "images_4", ...), inside the dataset or a path; intrinsics follow the real size
    of each photograph. holdout: every how many-th view is for testing; 0 for none. cameras_only: look at no photograph,
    cameras keep the model's size. Raises SceneError, FormatError.
    """
    folder = Path(folder)
    location = find_model(folder)
    model = read_model(location)
    if not model.views:
        raise SceneError(f"{location}: has no view with a pose")
    if need_points and not len(model.points):
        raise SceneError(f"{location}: has no 3-D points to start from")
    if cameras_only:
        cameras = [pinhole_camera(v, v.camera.width, v.camera.height)[0] for v in model.views]
        photos: list[Photo] = []
    else:
        cameras, photos = _fit_photos(model.views, _image_folder(folder, location, images or "images"))
    test = [i for i in range(len(cameras)) if holdout and i % holdout == 0]
    train = [i for i in range(len(cameras)) if not holdout or i % holdout]
    return Dataset(cameras, model.points, model.point_colors, train, test, photos, background, memory_budget)


def _image_folder(folder: Path, location: Path, images: str) -> Path:
    """The first folder of that name, from the model's folder up to the dataset's root; else the path itself."""
    here = Path(os.path.abspath(folder))
    above = here.parents[:2] if folder == location or here.name == "sparse" else ()
    for candidate in [*(base / images for base in (here, *above)), Path(images)]:
        if os.path.isdir(candidate):
            return candidate
    raise SceneError(f"{folder}: has no image folder {images}")


def _fit_photos(views: list[View], folder: Path) -> tuple[list[Camera], list[Photo]]:
    """A pinhole camera of the photograph's size for every view, and where its photograph is."""
    missing = [view.name for view in views if not os.path.isfile(folder / view.name)]
    if missing:
        shown = ", ".join(missing[:MISSING_SHOWN]) + (", ..." if len(missing) > MISSING_SHOWN else "")
        raise SceneError(f"{folder}: {len(missing)} of {len(views)} photographs are missing: {shown}")
    cameras, photos = [], []
    for view in views:
        path = folder / view.name
        camera, distorted = pinhole_camera(view, *image_size(path, upright=False))
        cameras.append(camera)
        photos.append(Photo(path, distorted))
    return cameras, photos
