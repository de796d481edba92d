"""Reads transforms.json, the cameras of Nerfstudio and instant-ngp, which many programs export.

A frame's `transform_matrix` is camera to world, in a camera frame with x right, y up and z backwards (OpenGL,
Blender). Intrinsics are keys of the file or of a frame: fl_x, fl_y, cx, cy, w, h in pixels, or camera_angle_x
in radians, and the distortion of OpenCV. The world is that of the file: in Nerfstudio z is up.
`ply_file_path` names the sparse points, in the same world.

Nerfstudio turns and scales the world again when it trains, and writes how to dataparser_transforms.json in
the folder of its run. A copy of that file beside transforms.json moves cameras and points into the world of
the trained splat.
"""

from __future__ import annotations

import math
import os
from collections import ChainMap
from collections.abc import Mapping
from functools import partial
from pathlib import Path, PurePosixPath

import numpy as np

from ..files.images import MAX_SIDE, image_size
from ..files.ply_points import read_points
from ..files.reading import read_json, usable
from ..scene.rotations import is_rotation
from ..system.errors import FormatError
from ..system.foreign import check_name
from .photo_files import photograph
from .sparse_model import Intrinsics, Model, Source, View

NAME, PARSER_NAME = "transforms.json", "dataparser_transforms.json"
MAX_BYTES = 64 * 2**20
LARGEST = 1e12  # of the absolute value of a number
SPLIT = ("train_filenames", "val_filenames", "test_filenames")
PERSPECTIVE = ("OPENCV", "PINHOLE", "SIMPLE_PINHOLE", "SIMPLE_RADIAL", "RADIAL")
FISHEYE = "OPENCV_FISHEYE"
FLIP = np.diag([1.0, -1.0, -1.0, 1.0])  # camera axes of OpenGL <-> of COLMAP


def read_transforms(path: Path) -> Source:
    """Reads a transforms.json and the sparse points that it names. Raises FormatError."""
    facts = _read_json(path)
    frames = facts.get("frames")
    if not isinstance(frames, list) or not frames:
        raise FormatError(f"{path}: holds no frames; give a transforms.json of Nerfstudio or instant-ngp")
    names = [usable(path, f"frame {number}", partial(_name, frame)) for number, frame in enumerate(frames)]
    common = os.path.commonpath([PurePosixPath(name).parent for name in names])
    folder = path.parent / common
    views, missing = [], []
    for name, frame in zip(names, frames, strict=True):
        name, both = str(PurePosixPath(name).relative_to(common)), ChainMap(frame, facts)
        if not {"w", "h"} <= both.keys() and photograph(folder, name) is None:
            missing.append(name)  # nothing says its size
            continue
        views.append(usable(path, name, partial(_view, name, both, folder)))
    if missing and not views:
        raise FormatError(f"{path}: neither w and h nor any of its photographs is there")
    views.sort(key=lambda view: view.name)
    twice = next((a.name for a, b in zip(views, views[1:], strict=False) if a.name == b.name), None)
    if twice is not None:
        raise FormatError(f"{path}: names the photograph {twice!r} twice; export it again")
    points, colors, notes = _points(path, facts)
    model, moved = _in_parser_world(path, facts, Model(views, points, colors))
    masks = {
        str(PurePosixPath(name).relative_to(common)): path.parent
        / usable(path, name, partial(_relative, frame, "mask_path"))
        for name, frame in zip(names, frames, strict=True)
        if frame.get("mask_path")
    }
    if split := [key for key in SPLIT if facts.get(key)]:
        named = " and ".join(split)
        notes = (*notes, f"{path.name} has {named}, which do not count: --holdout says what is held out")
    if missing:
        some = ", ".join(missing[:3]) + (", ..." if len(missing) > 3 else "")
        notes = (*notes, f"left out, because nothing says the size of a photograph: {some}")
    return Source(model, path, folder, (f"the cameras are those of {path}", *moved, *notes), masks)


def _read_json(path: Path) -> dict:
    """The JSON object in a file. Raises FormatError."""
    facts = read_json(path, MAX_BYTES, "a transforms.json of Nerfstudio or instant-ngp")
    if not isinstance(facts, dict):
        raise FormatError(f"{path}: holds no object; give a transforms.json of Nerfstudio or instant-ngp")
    return facts


def _name(frame: object) -> str:
    """The path of the frame's photograph, relative to the file, with '/' between folders."""
    if not isinstance(frame, dict):
        raise FormatError("not an object")
    return str(PurePosixPath(_relative(frame, "file_path")))


def _relative(frame: dict, key: str) -> str:
    """The path at this key, with '/' between folders."""
    if not isinstance(frame[key], str):
        raise FormatError(f"its {key} is no text")
    name = frame[key].replace("\\", "/")
    check_name(name)
    return name


def _view(name: str, facts: Mapping, folder: Path) -> View:
    """The view of a frame. facts: its keys and those of the file."""
    to_world = _matrix(facts["transform_matrix"]) @ FLIP
    if not is_rotation(to_world[:3, :3]):
        raise FormatError("its transform_matrix does not hold a rotation")
    viewmat = np.eye(4)
    viewmat[:3, :3] = to_world[:3, :3].T
    viewmat[:3, 3] = -to_world[:3, :3].T @ to_world[:3, 3]
    return View(name, viewmat, _camera(facts, *_size(facts, folder, name)))


def _matrix(rows: object) -> np.ndarray:
    """A (4, 4) matrix, perhaps without its last row. Raises FormatError for infinite or huge numbers."""
    matrix, last = np.array(rows, np.float64), [[0, 0, 0, 1]]
    if matrix.shape == (3, 4):
        matrix = np.concatenate([matrix, last])
    finite = (np.abs(matrix) < LARGEST).all()
    if matrix.shape != (4, 4) or not finite or not np.array_equal(matrix[3:], last):
        raise FormatError("a matrix of 4 x 4 finite numbers is expected")
    return matrix


def _size(facts: Mapping, folder: Path, name: str) -> tuple[int, int]:
    """(width, height) in pixels: the keys w and h, or else the size of the photograph."""
    if "w" not in facts or "h" not in facts:  # read_transforms() left it out without its photograph
        return image_size(photograph(folder, name) or folder / name)
    width, height = (_number(facts, key) for key in ("w", "h"))
    if not all(0 < side <= MAX_SIDE and side == int(side) for side in (width, height)):
        raise FormatError(
            f"its size is {width:g} x {height:g}; whole numbers of 1 to {MAX_SIDE} are expected"
        )
    return int(width), int(height)


def _camera(facts: Mapping, width: int, height: int) -> Intrinsics:
    """The camera of a frame."""
    model = FISHEYE if facts.get("is_fisheye") is True else facts.get("camera_model", "OPENCV")
    if model not in (*PERSPECTIVE, FISHEYE):
        raise FormatError(
            f"its camera_model is {str(model)[:40]!r}; export photographs without distortion, or with the"
            " model OPENCV"
        )
    fx = _focal(facts, "x", width)
    fy = _focal(facts, "y", height) if "fl_y" in facts or "camera_angle_y" in facts else fx
    pinhole = [fx, fy, _number(facts, "cx", width / 2), _number(facts, "cy", height / 2)]
    k1, k2, k3, k4, p1, p2 = _distortion(facts)
    params: list[float] = []
    if model == FISHEYE:
        params = [k1, k2, k3, k4]
    elif k4:
        raise FormatError(
            f"its distortion has k4 = {k4:g}, which is not supported; export photographs without distortion,"
            " or with k1, k2, k3, p1, p2"
        )
    elif k3:
        model, params = "FULL_OPENCV", [k1, k2, p1, p2, k3, 0.0, 0.0, 0.0]
    elif k1 or k2 or p1 or p2:
        model, params = "OPENCV", [k1, k2, p1, p2]
    else:
        model = "PINHOLE"
    return Intrinsics(model, width, height, (*pinhole, *params))


def _distortion(facts: Mapping) -> list[float]:
    """k1, k2, k3, k4, p1, p2: as keys, or as the list of Nerfstudio."""
    names = ("k1", "k2", "k3", "k4", "p1", "p2")
    if "distortion_params" not in facts:
        return [_number(facts, key, 0.0) for key in names]
    given = facts["distortion_params"]
    if not isinstance(given, list) or len(given) != len(names):
        raise FormatError(f"its distortion_params are not the six numbers {', '.join(names)}")
    return [_number(dict(zip(names, given, strict=True)), key) for key in names]


def _focal(facts: Mapping, axis: str, side: int) -> float:
    """The focal length in pixels along an axis: fl_x or fl_y, or from the angle of view over `side`."""
    if f"fl_{axis}" in facts:
        focal = _number(facts, f"fl_{axis}")
    elif f"camera_angle_{axis}" in facts:
        angle = _number(facts, f"camera_angle_{axis}")
        focal = side / 2 / math.tan(angle / 2) if 0 < angle < math.pi else 0.0
    else:
        raise FormatError("neither fl_x nor camera_angle_x is there")
    if not 0 < focal < LARGEST:
        raise FormatError("its focal length is not usable")
    return focal


def _number(facts: Mapping, key: str, default: float | None = None) -> float:
    """A finite number. Raises FormatError; KeyError if it is missing and there is no default."""
    value = facts[key] if default is None else facts.get(key, default)
    if isinstance(value, bool) or not isinstance(value, int | float) or not abs(float(value)) < LARGEST:
        raise FormatError(f"{key} is {str(value)[:40]}; a finite number is expected")
    return float(value)


def _points(path: Path, facts: dict) -> tuple[np.ndarray, np.ndarray, tuple[str, ...]]:
    """Positions (P, 3) float32 and colours (P, 3) uint8 of the sparse points, and what is missing, in
    sentences."""
    none = np.empty((0, 3), np.float32), np.empty((0, 3), np.uint8)
    if facts.get("ply_file_path") is None:
        return *none, ()
    file = path.parent / usable(path, "ply_file_path", lambda: _relative(facts, "ply_file_path"))
    if not file.is_file():
        return *none, (f"{file}: the sparse points that {path.name} names are missing",)
    return *read_points(file), ()


def _in_parser_world(path: Path, facts: dict, model: Model) -> tuple[Model, tuple[str, ...]]:
    """The model in the world of a splat trained by Nerfstudio, if that is known, and a sentence on it."""
    file = path.with_name(PARSER_NAME)
    if not file.is_file():
        return model, ()
    matrix = usable(file, "it", lambda: _parser_matrix(_read_json(file), facts))
    back, scale, views = np.linalg.inv(matrix), np.linalg.det(matrix[:3, :3]) ** (1 / 3), []
    for view in model.views:
        viewmat = view.viewmat @ back
        viewmat[:3] *= scale
        views.append(View(view.name, viewmat, view.camera))
    points = model.points.astype(np.float64) @ matrix[:3, :3].T + matrix[:3, 3]
    return Model(views, points.astype(np.float32), model.point_colors), (
        f"{file}: cameras are moved into the world of the splat trained with it",
    )


def _parser_matrix(parser: dict, facts: dict) -> np.ndarray:
    """(4, 4) from the world of transforms.json to that of the trained splat.

    dataparser_transforms.json leads there from the world before applied_transform and applied_scale, which
    transforms.json holds.
    """
    matrix = _matrix(parser["transform"])
    scale = _number(parser, "scale") / _number(facts, "applied_scale", 1.0)
    if "applied_transform" in facts:
        matrix = matrix @ np.linalg.inv(_matrix(facts["applied_transform"]))
    if not 0 < scale < LARGEST or not is_rotation(matrix[:3, :3]):
        raise FormatError("it is no rotation with a scale")
    return np.diag([scale, scale, scale, 1.0]) @ matrix
