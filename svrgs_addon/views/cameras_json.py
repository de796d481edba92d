"""Reads and writes the cameras.json that 3DGS training writes: a list of views without photographs."""

from __future__ import annotations

import json
import os
from collections.abc import Sequence
from functools import partial
from pathlib import Path

import numpy as np

from ..files.atomic import write_bytes
from ..files.images import MAX_SIDE
from ..files.reading import read_json, usable
from ..scene.camera import MAX_DISTANCE, Camera
from ..scene.rotations import is_rotation
from ..system.errors import FormatError
from ..system.foreign import check_name

MAX_BYTES = 64 * 2**20


def load_cameras_json(path: str | os.PathLike) -> list[Camera]:
    """The cameras of a 3DGS cameras.json in file order. The principal point is the image centre, as in 3DGS.

    Keys of an entry: img_name; width, height, fx, fy (pixels); position (3, world); rotation (3x3, camera to
    world). Extensions of this project: cx, cy (pixels) name another principal point; with "orthographic":
    true, fx and fy are pixels per unit of length; "unit" is Camera.unit. Without it that is 1, until
    the scene is known (scene.camera.in_their_unit()). Raises FormatError.
    """
    entries = read_json(Path(path), MAX_BYTES, "a cameras.json of 3DGS")
    if not isinstance(entries, list) or not entries:
        raise FormatError(f"{path}: holds no list of cameras; give a cameras.json of 3DGS")
    return [
        usable(Path(path), f"camera {number}", partial(_camera, facts))
        for number, facts in enumerate(entries)
    ]


def write_cameras_json(path: str | os.PathLike, cameras: Sequence[Camera]):
    """Writes the cameras. The file is replaced as a whole. Raises SceneError if it cannot be written."""
    entries = []
    for number, camera in enumerate(cameras):
        entry: dict[str, object] = {
            "id": number,
            "img_name": camera.name,
            "width": camera.width,
            "height": camera.height,
            "position": camera.position.tolist(),
            "rotation": camera.viewmat[:3, :3].T.tolist(),
            "fy": float(camera.K[1, 1]),
            "fx": float(camera.K[0, 0]),
        }
        if camera.unit != 1:
            entry["unit"] = camera.unit
        if camera.orthographic:
            entry["orthographic"] = True
        centre = {"cx": float(camera.K[0, 2]), "cy": float(camera.K[1, 2])}
        if centre != {"cx": camera.width / 2, "cy": camera.height / 2}:
            entry |= centre
        entries.append(entry)
    write_bytes(path, json.dumps(entries, indent=1).encode())


def _camera(entry: dict) -> Camera:
    """The camera of an entry. Raises FormatError, KeyError, TypeError, ValueError or OverflowError."""
    if not isinstance(entry, dict):
        raise FormatError("not an object")
    name = str(entry["img_name"])
    check_name(name, "image")
    width, height = (_side(entry[key]) for key in ("width", "height"))
    fx, fy = float(entry["fx"]), float(entry["fy"])
    position = np.array(entry["position"], np.float64).reshape(3)
    rotation = np.array(entry["rotation"], np.float64).reshape(3, 3)  # camera to world
    if not is_rotation(rotation):
        raise FormatError("its rotation is not a rotation matrix")
    orthographic = entry.get("orthographic", False)
    if type(orthographic) is not bool:
        raise FormatError(f"orthographic is {orthographic!r}; true or false is expected")
    viewmat = np.eye(4)
    viewmat[:3, :3] = rotation.T
    with np.errstate(all="ignore"):  # the camera is checked below
        viewmat[:3, 3] = -rotation.T @ position
    cx, cy = float(entry.get("cx", width / 2)), float(entry.get("cy", height / 2))
    K = np.array([[fx, 0, cx], [0, fy, cy], [0, 0, 1]])
    unit = float(entry.get("unit", 1.0))
    camera = Camera(viewmat, K, width, height, name, orthographic, unit=unit)
    if not (camera.usable and 0 < unit < MAX_DISTANCE):
        raise FormatError("its focal length, position or unit is not usable")
    return camera


def _side(value: object) -> int:
    """Checks the width or height of an image, in pixels. Raises FormatError."""
    value = int(value) if isinstance(value, float) and value.is_integer() else value
    if type(value) is not int or not 0 < value <= MAX_SIDE:
        raise FormatError(f"an image side is {value}; 1 to {MAX_SIDE} is expected")
    return value
