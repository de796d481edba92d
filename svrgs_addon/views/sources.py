"""Finds what holds the cameras of a dataset, and reads it: a COLMAP model or transforms.json."""

from __future__ import annotations

import os
from dataclasses import replace
from pathlib import Path

from ..system.errors import SceneError
from .colmap import find_model, read_model
from .sparse_model import Source
from .transforms_json import NAME, read_transforms

HEAD_BYTES = 64 * 1024  # read of a file that may be of another program
EXPORTS = {
    "Metashape": "in Metashape 2.2 or later, choose File > Export > Export Cameras and the file type Colmap",
    "RealityScan": (
        "in RealityScan, or RealityCapture 1.5 or later, choose Alignment > Registration and the format"
        " COLMAP"
    ),
}


def read_source(folder: Path, images: str | None, with_images: bool = True) -> Source:
    """Reads the COLMAP model in `folder` or below it; where there is none, its transforms.json, which can
    also be named itself.

    images: name of the image folder in the dataset, or a path; None: that of the dataset. Raises SceneError,
    FormatError.
    """
    location, is_model = find_cameras(folder)
    if not is_model:
        source = read_transforms(location)
        if with_images and images:
            return replace(source, image_folder=_image_folder(location.parent, None, images))
        return source if with_images else replace(source, image_folder=None)
    other = folder / NAME
    notes = (f"the cameras are those of {location}, not those of {other}",) if other.is_file() else ()
    model = read_model(location)
    image_folder = _image_folder(folder, location, images) if with_images else None
    return Source(model, location, image_folder, notes)


def find_cameras(folder: Path) -> tuple[Path, bool]:
    """(folder of the COLMAP model, True) or (transforms.json, False), reading neither. Raises SceneError."""
    transforms = folder if folder.is_file() else folder / NAME
    try:
        return find_model(folder), True
    except SceneError as error:
        if transforms.is_file():
            return transforms, False
        raise SceneError(_other_program(folder) or f"{error}, and no {NAME}") from None


def _image_folder(folder: Path, location: Path | None, given: str | None) -> Path:
    """The first folder with this name (None: images) from the given folder up to the root of the dataset,
    else the path that is given. Raises SceneError."""
    images = given or "images"
    here = Path(os.path.abspath(folder))
    above = here.parents[:2] if folder == location or here.name == "sparse" else ()
    for candidate in [*(base / images for base in (here, *above)), *([Path(given)] if given else [])]:
        if os.path.isdir(candidate):
            return candidate
    raise SceneError(
        f"{folder}: has no image folder {images}; give the name or path of the folder with the photographs"
    )


def _other_program(folder: Path) -> str:
    """A sentence if the folder holds cameras of a program whose files are not read; else ''."""
    for path in sorted(folder.iterdir()) if folder.is_dir() else ():
        program = _program(path)
        if program:
            return f"{path}: the cameras of {program} are not read; export them as COLMAP: {EXPORTS[program]}"
    return ""


def _program(path: Path) -> str:
    """The program that wrote the file: a name of EXPORTS, or ''."""
    suffix = path.suffix.lower()
    if suffix in (".rcproj", ".psx", ".psz"):
        return "RealityScan" if suffix == ".rcproj" else "Metashape"
    if suffix not in (".xml", ".csv") or not path.is_file():
        return ""
    try:
        with open(path, "rb") as file:
            start = file.read(HEAD_BYTES)
    except OSError:
        return ""
    if suffix == ".xml":
        return "Metashape" if b"<chunk" in start else ""
    return "RealityScan" if start.lstrip(b"\xef\xbb\xbf").lower().startswith(b"#name") else ""
