"""A dataset for fine-tuning and evaluation: posed photographs and sparse points, from COLMAP or
transforms.json.

Photographs are read on demand, cached up to a memory budget, and can be read ahead in background threads.
"""

from __future__ import annotations

import hashlib
import itertools
import logging
import os
import threading
from collections import deque
from collections.abc import Callable, Generator, Iterable, Iterator
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from ..files.images import image_size, read_pixels, to_bytes
from ..scene.camera import Camera, extent_of, in_their_unit
from ..system.errors import SceneError, system_errors
from ..system.file_names import extended
from .colmap import pinhole_camera, undistort_image
from .photo_files import photograph, present
from .reduced_photos import toned
from .sources import Source, read_source
from .valid_pixels import BACKGROUND, MaskOptions, Masks, masks_of

if TYPE_CHECKING:
    import pycolmap

HOLDOUT = 8  # every 8th image in name order is a test view, as in 3DGS
MEMORY_BUDGET = 4 * 2**30  # bytes of cached photographs
READ_AHEAD = 3  # photographs
READER_THREADS = 2


@dataclass(frozen=True)
class Photo:
    """The file of a view's photograph, its camera if it has distortion (None: a pinhole camera), and where it
    is not painted with the background, bits as Camera.valid_bits (None: everywhere)."""

    path: Path
    distorted: pycolmap.Camera | None
    unpainted: np.ndarray | None = None


@dataclass
class Dataset:
    """Views in the order of image names, with pinhole cameras for the undistorted and scaled photographs, and
    sparse points. Views without photograph are left out; `notes` says so. Coordinates are those of the
    files."""

    cameras: list[Camera]
    points: np.ndarray  # (P, 3) float32
    point_colors: np.ndarray  # (P, 3) uint8
    train_indices: list[int]
    test_indices: list[int]
    # test views in which something was decided (finetune/quality.py); they are not in test_indices
    deciding_indices: list[int] = field(default_factory=list, kw_only=True)
    photos: list[Photo] = field(default_factory=list)  # one per camera; empty if only cameras were loaded
    background: tuple[float, float, float] = (0, 0, 0)  # display sRGB 0..1, behind transparent pixels
    memory_budget: int = MEMORY_BUDGET  # bytes of cached photographs
    notes: tuple[str, ...] = ()  # sentences that the user must see: what is missing, which cameras were read
    # (3, 256), the curve that the channels of photographs follow (reduced_photos.toned); None: as they are
    tone: np.ndarray | None = None
    _cache: dict[int, np.ndarray] = field(default_factory=dict, repr=False)
    _lock: threading.Lock = field(default_factory=threading.Lock, repr=False)

    @property
    def training_cameras(self) -> list[Camera]:
        """The cameras of train_indices."""
        return [self.cameras[i] for i in self.train_indices]

    @property
    def extent(self) -> float:
        """Of the training cameras; without them, of all (scene.camera.extent_of)."""
        return extent_of(self.training_cameras or self.cameras)

    def image(self, index: int) -> np.ndarray:
        """The photograph of cameras[index], (H, W, 3) display sRGB, read-only. Pixels that do not count
        (Camera.valid) are 0.

        It is uint8, or float32 in 0..1 if the file has more than 8 bits per channel and was not undistorted.
        Raises FormatError, SceneError.
        """
        with self._lock:
            image = self._cache.get(index)
        return self._read(index) if image is None else image

    def stream(self, order: Iterable, read: Callable | None = None) -> Generator[tuple]:
        """Yields (item, read(item)) for each item of `order`, which may be endless. Threads read READ_AHEAD
        items in advance.

        read: image() by default; items are then indices. The result does not depend on the timing of the
        threads. They end when the iterator is exhausted or closed.
        """
        read = read or self.image
        order = iter(order)
        pool = ThreadPoolExecutor(READER_THREADS)
        try:
            pending = deque((item, pool.submit(read, item)) for item in itertools.islice(order, READ_AHEAD))
            while pending:
                item, result = pending.popleft()
                pending.extend((item, pool.submit(read, item)) for item in itertools.islice(order, 1))
                yield item, result.result()
        finally:
            pool.shutdown(cancel_futures=True)

    def window(self, index: int) -> tuple[slice, slice] | None:
        """The rows and columns of the photograph of cameras[index] that count. None: all."""
        return None

    @property
    def unexplained(self) -> float:
        """The mean squared error, colours in 0..1, that an allowed drop counts in addition."""
        return 0.0

    def inputs(self) -> Iterator[bytes]:
        """Digests and texts of cameras and photographs: equal ones give equal runs. Raises SceneError."""
        if self.tone is not None:
            yield self.tone.tobytes()
        for one in self.cameras:
            if one.valid_bits is not None:
                yield one.valid_bits.tobytes()
            yield repr((one.name, one.width, one.height, one.viewmat.tolist(), one.K.tolist())).encode()
        for photo in self.photos:
            if photo.unpainted is not None:
                yield photo.unpainted.tobytes()
            with system_errors(SceneError, f"{photo.path}: cannot be read"), open(photo.path, "rb") as file:
                digest = hashlib.file_digest(file, "sha256").digest()
            yield digest

    def _read(self, index: int) -> np.ndarray:
        """Reads an image, and caches it if it fits into the budget. Cached images are never replaced: in a
        random order, no other rule gives more hits. Raises FormatError, SceneError."""
        image = self._pixels(index)
        image.flags.writeable = False
        with self._lock:
            used = sum(cached.nbytes for cached in self._cache.values())
            if used + image.nbytes <= self.memory_budget:
                self._cache[index] = image
        return image

    def _pixels(self, index: int) -> np.ndarray:
        """Reads and undistorts a photograph. Raises FormatError, SceneError."""
        if not self.photos:
            raise SceneError("the dataset was loaded without its photographs")
        photo, camera = self.photos[index], self.cameras[index]
        image = read_pixels(photo.path, self.background)
        if photo.distorted is not None:
            image = undistort_image(to_bytes(image), photo.distorted)
        if image.shape != (camera.height, camera.width, 3):
            raise SceneError(f"{photo.path}: its size has changed since the dataset was loaded; start again")
        if self.tone is not None:
            image = toned(image, self.tone)
        unpainted = replace(camera, valid_bits=photo.unpainted).valid
        for valid, colour in ((camera.valid, (0, 0, 0)), (unpainted, self.background)):
            if valid is not None:
                image[valid == 0] = to_bytes(np.array(colour)) if image.dtype == np.uint8 else colour
        return image


def in_training_views(dataset: Dataset) -> list[str]:
    """A sentence if quality is measured on photographs that were trained on, because none is held out."""
    if dataset.test_indices or not dataset.photos:
        return []
    return ["no view is held out, so quality is measured in the training views"]


def load_dataset(
    folder: str | os.PathLike,
    images: str | None = None,
    *,
    holdout: int = HOLDOUT,
    background: tuple[float, float, float] = (0, 0, 0),
    cameras_only: bool = False,
    need_points: bool = False,
    memory_budget: int = MEMORY_BUDGET,
    masks: MaskOptions = MaskOptions(),
) -> Dataset:
    """Loads a dataset. folder: its root, its `sparse` or `sparse/0`, the folder of the model's files, or a
    transforms.json.

    images: name of the image folder in the dataset ("images", "images_4", ...), or a path; default "images".
    Intrinsics are scaled to the size of each photograph. holdout: every holdout-th view in name order is a
    test view; 0: none. background: display sRGB 0..1, behind transparent pixels. cameras_only: no photograph
    is opened; cameras have the size in the model. need_points: refuse a model without points. memory_budget:
    bytes of cached photographs. masks: which pixels of the photographs count.

    Views whose photograph is missing are left out and logged as a warning. The others stay test or training
    views as in the whole dataset. Raises SceneError, FormatError; SceneError also if fewer than a third of
    the photographs are there.
    """
    source = read_source(extended(folder), images, not cameras_only)
    model, notes = source.model, source.notes
    if not model.views:
        raise SceneError(f"{source.location}: has no view with a pose; run COLMAP's mapper again")
    if need_points and not len(model.points):
        raise SceneError(
            f"{source.location}: has no 3-D points to start from; run COLMAP's mapper again, or export the"
            " sparse points"
        )
    numbers, photos = list(range(len(model.views))), list[Photo]()
    if source.image_folder is None:
        cameras = [pinhole_camera(v, v.camera.width, v.camera.height)[0] for v in model.views]
    else:
        numbers, cameras, photos, more = _photographed(source, source.image_folder, masks)
        notes += more
    for note in notes:
        logging.warning("%s", note)
    cameras = in_their_unit(cameras, model.points)
    test = [k for k, i in enumerate(numbers) if holdout and i % holdout == 0]
    train = [k for k, i in enumerate(numbers) if not holdout or i % holdout]
    return Dataset(
        cameras, model.points, model.point_colors, train, test, photos, background, memory_budget, notes
    )


def _photographed(
    source: Source, folder: Path, options: MaskOptions
) -> tuple[list[int], list[Camera], list[Photo], tuple[str, ...]]:
    """The numbers of the views that have a photograph with pixels that count, their cameras and photographs,
    and sentences for the user. Raises SceneError, FormatError."""
    numbers, notes = present([view.name for view in source.model.views], folder)
    cameras, photos, sizes = [], [], []
    for view in (source.model.views[i] for i in numbers):
        # reading a photograph that has gone meanwhile says so
        path = photograph(folder, view.name) or folder / view.name
        sizes.append(image_size(path))
        camera, distorted = pinhole_camera(view, *sizes[-1])
        cameras.append(camera)
        photos.append(Photo(path, distorted))
    masks = masks_of(options, folder, source.masks)
    if not masks.expected:
        return numbers, cameras, photos, notes

    def valid_bits(k: int) -> tuple[np.ndarray | None, float | None]:
        """Camera.valid_bits, and the share of the pixels that count."""
        valid = _valid_of(masks, cameras[k].name, photos[k], sizes[k])
        return (None, None) if valid is None else (np.packbits(valid, axis=1), float(valid.mean()))

    with ThreadPoolExecutor(READER_THREADS) as pool:
        bits, shares = zip(*pool.map(valid_bits, range(len(photos))), strict=True)
    notes += masks.notes(shares)
    if options.outside == BACKGROUND:
        photos = [replace(photo, unpainted=one) for photo, one in zip(photos, bits, strict=True)]
        return numbers, cameras, photos, notes
    shown = [k for k, share in enumerate(shares) if share != 0]
    cameras = [replace(cameras[k], valid_bits=bits[k]) for k in shown]
    return [numbers[k] for k in shown], cameras, [photos[k] for k in shown], notes


def valid_of_photograph(
    folder: Path, images: str | None, options: MaskOptions, name: str
) -> np.ndarray | None:
    """The pixels of one photograph that count in load_dataset(), (H, W) uint8 of 0 and 1, undistorted; None:
    all. name: of its view. Raises SceneError, FormatError."""
    source = read_source(Path(extended(folder)), images)
    view = next((view for view in source.model.views if view.name == name), None)
    if view is None or source.image_folder is None:
        raise SceneError(f"{source.location}: has no view {name}")
    masks = masks_of(options, source.image_folder, source.masks)
    if not masks.expected:
        return None
    path = photograph(source.image_folder, name) or source.image_folder / name
    size = image_size(path)
    return _valid_of(masks, name, Photo(path, pinhole_camera(view, *size)[1]), size)


def _valid_of(masks: Masks, name: str, photo: Photo, size: tuple[int, int]) -> np.ndarray | None:
    """As Masks.valid(), undistorted. size: (width, height) of the photograph. Raises FormatError."""
    valid = masks.valid(name, photo.path, *size)
    if valid is None or photo.distorted is None:
        return valid
    white = np.repeat(255 * valid[..., None], 3, axis=2)
    return (undistort_image(white, photo.distorted)[..., 0] == 255).astype(np.uint8)
