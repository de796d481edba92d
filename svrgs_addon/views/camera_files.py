"""Cameras without photographs, from either of the files that programs write: cameras.json of 3DGS,
transforms.json of Nerfstudio and instant-ngp."""

from __future__ import annotations

import os
from pathlib import Path

from ..scene.camera import Camera
from .cameras_json import load_cameras_json
from .dataset import load_dataset

START = 4096  # bytes in which the first character of the JSON stands


def load_cameras(path: str | os.PathLike) -> list[Camera]:
    """The cameras of a file, in the order of their names. A list is a cameras.json, an object a
    transforms.json. Raises FormatError, SceneError."""
    if _holds_object(Path(path)):
        return load_dataset(path, cameras_only=True).cameras
    return sorted(load_cameras_json(path), key=lambda camera: camera.name)


def _holds_object(path: Path) -> bool:
    if not path.is_file():
        return False
    try:
        with open(path, "rb") as file:
            return file.read(START).removeprefix(b"\xef\xbb\xbf").lstrip().startswith(b"{")
    except OSError:
        return False  # reading it says why
