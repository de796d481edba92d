"""Masks of photographs: which pixels count. Passers-by, tripods, skies and turntables do not.

A mask is an image of the shape of its photograph, of any size. As in COLMAP, a pixel does not count where it
is 0; lossy files, such as JPEG, count from half of full white on.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from statistics import fmean

import numpy as np

from ..files.images import read_alpha, read_pixels, to_float
from ..scene.camera import resized_valid, view_stem
from ..system.errors import FormatError, SceneError
from .photo_files import EXTENSIONS

FOLDER = "masks"  # beside the folder of the photographs
LOSSY = (".jpg", ".jpeg")
AUTO, IGNORE, BACKGROUND = "auto", "ignore", "background"
ASPECT = 0.01  # by which the sides of mask and photograph may differ in scale


@dataclass(frozen=True)
class MaskOptions:
    """folder: of the masks; None: those that the dataset names, or masks beside its photographs. inverted:
    pixels count where a mask is 0. used: False: all pixels of all photographs count. outside: what is done
    with pixels that do not count: IGNORE; BACKGROUND: they are painted with the background, as for an object
    on a turntable; AUTO: masks ignore, and transparent pixels are painted."""

    folder: Path | None = None
    inverted: bool = False
    outside: str = AUTO
    used: bool = True


@dataclass(frozen=True)
class Masks:
    """The masks of a dataset, found by the names of its photographs."""

    options: MaskOptions
    folder: Path | None  # that is searched
    named: dict[str, Path]  # by photograph, as the dataset names them

    def file(self, name: str) -> Path | None:
        """The mask of a photograph: named, or NAME.jpg.png (COLMAP), NAME.png, NAME.jpg in the folder."""
        if name in self.named and self.named[name].is_file():
            return self.named[name]
        if self.folder is None:
            return None
        candidates = (f"{name}.png", *(f"{view_stem(name)}{extension}" for extension in EXTENSIONS))
        return next((path for path in map(self.folder.joinpath, candidates) if path.is_file()), None)

    def valid(self, name: str, photo: Path, width: int, height: int) -> np.ndarray | None:
        """The pixels of a photograph that count, (H, W) uint8 of 0 and 1; None: all. Raises FormatError."""
        path, alpha = self.file(name), read_alpha(photo) if self.options.outside == IGNORE else None
        opaque = None if alpha is None else (alpha >= 0.5).astype(np.uint8)
        if path is None:
            return opaque
        brightness = to_float(read_pixels(path)).max(axis=2)
        valid = brightness >= 0.5 if path.suffix.lower() in LOSSY else brightness > 0
        scales = valid.shape[0] / height, valid.shape[1] / width
        if abs(scales[0] / scales[1] - 1) > ASPECT:
            raise FormatError(
                f"{path}: has {valid.shape[1]} x {valid.shape[0]} pixels, its photograph {width} x {height};"
                " a mask must have the shape of its photograph"
            )
        found = valid != self.options.inverted
        valid = resized_valid(found.astype(np.uint8), width, height)
        return valid if opaque is None else valid & opaque

    @property
    def expected(self) -> bool:
        """Whether any may be there. Raises SceneError if none can be, and some are asked for."""
        if not self.options.used:
            return False
        if self.options.inverted and self.folder is None and not self.named:
            raise SceneError("--invert-masks: the dataset has no masks; give --masks DIR")
        return self.folder is not None or bool(self.named) or self.options.outside == IGNORE

    def notes(self, shares: Sequence[float | None]) -> tuple[str, ...]:
        """What the user must know. shares: of the pixels of each view that count; None: it has no mask.
        Raises SceneError if none has a mask in a given folder, or if all are black."""
        masked = [share for share in shares if share is not None]
        black, where = masked.count(0), self.folder or "the dataset"
        if not masked and self.options.folder is not None:
            raise SceneError(
                f"{where}: holds no mask of these photographs; name them NAME.png or NAME.jpg.png"
            )
        missing = sum(not path.is_file() for path in self.named.values())
        lost = (f"the dataset names {missing} masks that are missing; all pixels of their photographs count",)
        if not masked and self.folder is not None and not missing:
            return (f"{where}: holds no mask of these photographs, so all of their pixels count",)
        if not masked:
            return lost if missing else ()
        if black == len(masked):
            raise SceneError(
                f"{where}: all masks are black, so no pixel counts; perhaps --invert-masks is meant"
            )
        done = "are painted with the background" if self.options.outside == BACKGROUND else "count nowhere"
        sentence = (
            f"{where}: {len(masked)} of {len(shares)} photographs have a mask; {1 - fmean(masked):.1%} of"
            f" their pixels {done}"
        )
        if black and self.options.outside != BACKGROUND:
            sentence += f"; {black} of the masks are black, and their photographs are left out"
        return (sentence, *(lost if missing else ()))


def masks_of(options: MaskOptions, image_folder: Path, named: dict[str, Path]) -> Masks:
    """named: by photograph, as the dataset names them. Raises SceneError without the given folder."""
    if options.folder is not None:
        if not options.folder.is_dir():
            raise SceneError(f"{options.folder}: is no folder; give the folder that holds the masks")
        return Masks(options, options.folder, {})
    beside = image_folder.parent / FOLDER
    return Masks(options, beside if beside.is_dir() else None, named)
