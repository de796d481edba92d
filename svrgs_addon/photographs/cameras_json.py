"""The cameras.json that 3DGS training writes: views without photographs."""

from __future__ import annotations

import json
import os
from pathlib import Path

import numpy as np

from ..camera import Camera
from ..errors import FormatError
from ..files.images import MAX_SIDE
from .colmap import check_name

MAX_BYTES = 64 * 2**20
MAX_SKEW = 1e-3  # by which a rotation may miss being one


def load_cameras_json(path: str | os.PathLike) -> list[Camera]:
    """The cameras of a 3DGS cameras.json, in file order; the principal point is the image centre, as in 3DGS.

    Entries: img_name, width, height, position (3), rotation (camera to world, 3x3), fy, fx. With "orthographic": true, which 3DGS does
    not know, fx and fy are pixels per unit of length. Raises FormatError.
    """
    entries = _read_entries(path)
    cameras = []
    for number, entry in enumerate(entries):
        try:
            cameras.append(_camera(entry))
        except (KeyError, TypeError, ValueError, OverflowError, FormatError) as error:
            reason = f"lacks {error}" if isinstance(error, KeyError) else str(error)
            raise FormatError(f"{path}: camera {number} is not usable ({reason})") from None
    return cameras


def _read_entries(path: str | os.PathLike) -> list:
    try:
        if os.path.getsize(path) > MAX_BYTES:
            raise FormatError(f"{path}: is larger than {MAX_BYTES // 2**20} MiB, too large for a cameras.json")
        entries = json.loads(Path(path).read_bytes())
    except OSError as error:
        raise FormatError(f"{path}: cannot be read ({error.strerror or error})") from error
    except (ValueError, RecursionError):
        raise FormatError(f"{path}: is not JSON") from None
    if not isinstance(entries, list) or not entries:
        raise FormatError(f"{path}: holds no list of cameras")
    return entries


def _camera(entry: dict) -> Camera:
    if not isinstance(entry, dict):
        raise FormatError("not an object")
    name = str(entry["img_name"])
    check_name(name)
    width, height = (_side(entry[key]) for key in ("width", "height"))
    fx, fy = float(entry["fx"]), float(entry["fy"])
    position = np.array(entry["position"], np.float64).reshape(3)
    rotation = np.array(entry["rotation"], np.float64).reshape(3, 3)  # camera to world
    if not (np.isfinite([fx, fy, *position]).all() and fx > 0 and fy > 0):
        raise FormatError("its focal length or position is not usable")
    if not np.abs(rotation).max() < 2 or not np.abs(rotation.T @ rotation - np.eye(3)).max() < MAX_SKEW or np.linalg.det(rotation) < 0:
        raise FormatError("its rotation is not a rotation")
    orthographic = entry.get("orthographic", False)
    if type(orthographic) is not bool:
        raise FormatError(f"orthographic is {orthographic!r}; true or false is expected")
    viewmat = np.eye(4)
    viewmat[:3, :3] = rotation.T
    viewmat[:3, 3] = -rotation.T @ position
    K = np.array([[fx, 0, width / 2], [0, fy, height / 2], [0, 0, 1]])
    return Camera(viewmat, K, width, height, name, orthographic)


def _side(value: object) -> int:
    if type(value) is not int or not 0 < value <= MAX_SIDE:
        raise FormatError(f"an image side is {value}; 1 to {MAX_SIDE} is expected")
    return value
