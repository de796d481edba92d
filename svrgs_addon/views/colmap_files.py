"""Checks the files of a COLMAP sparse model, and copies what the poses and points need of them.

pycolmap trusts the counts in binary files: a truncated points3D.bin makes it loop for ever. It takes
quaternions as they are, so one that has not the length 1 would stretch the view. And it refuses models in
which a point names a keypoint that its image does not have, as converters write them. In text files it takes
the first word of an image name for the whole. So counts and quaternions are checked here, and the copy has no
keypoints, no tracks and other image names: nothing needs the first two, and the caller gets the true names.
"""

from __future__ import annotations

import math
import os
import re
import struct
from collections.abc import Callable, Iterator
from functools import partial
from pathlib import Path

from ..system.errors import FormatError, SceneError

MODEL_FILES = ("cameras", "images", "points3D")
# in images.txt: id, quaternion, translation, camera id and a name, which is no number
IMAGE_LINE = re.compile(rb"\s*\d+(\s+[-+.\deE]+){7}\s+\d+\s+[^\s]*[^-+.\deE\s]")
MAX_LENGTH_ERROR = 1e-3  # of a quaternion; text files round to six digits
NONE = struct.pack("<Q", 0)  # the count of an image without keypoints, or of a point without a track

Record = tuple[bytes, int]  # the copy of a record, and the position after the record


def has_files(folder: Path, suffix: str) -> bool:
    """Whether the folder has all three files of a model with this suffix."""
    return all(os.path.isfile(folder / f"{name}{suffix}") for name in MODEL_FILES)


def copy_checked(folder: Path, target: Path, params_of: Callable[[int], int]) -> dict[int, str]:
    """Copies the binary files if they exist, else the text files, without keypoints and tracks. Returns the
    image names by image id.

    params_of: from the number of a camera model to the number of its parameters; ValueError for an unknown
    one. Raises FormatError; OSError if a file cannot be read; SceneError if the copy cannot be written.
    """
    names: dict[int, bytes] = {}
    if has_files(folder, ".bin"):
        copies: tuple[Callable[[bytes, int], Record], ...]
        copies = partial(_copy_camera, params_of), partial(_copy_image, names), _copy_point
        for name, copy in zip(MODEL_FILES, copies, strict=True):
            _write(target / f"{name}.bin", _binary_copy(folder / f"{name}.bin", copy))
    else:
        _write(target / "cameras.txt", (folder / "cameras.txt").read_bytes())
        lines = _image_lines(names, (folder / "images.txt").read_bytes())
        _write(target / "images.txt", b"\n".join(lines) + b"\n")
        lines = _point_lines((folder / "points3D.txt").read_bytes())
        _write(target / "points3D.txt", b"\n".join(lines) + b"\n")
    return {number: os.fsdecode(name) for number, name in names.items()}


def _write(path: Path, data: bytes) -> None:
    try:
        path.write_bytes(data)
    except OSError as error:
        raise SceneError(
            f"{path}: this temporary file cannot be written ({error.strerror or error}); free disk space, or"
            " set TMPDIR"
        ) from error


def _binary_copy(path: Path, copy: Callable[[bytes, int], Record]) -> bytes:
    """The copy of a binary file. Raises FormatError if its records need more bytes than the file has."""
    data = path.read_bytes()
    try:
        (count,) = struct.unpack_from("<Q", data)
        parts, position = [data[:8]], 8
        for _ in range(count):
            part, position = copy(data, position)
            parts.append(part)
        whole = position <= len(data)
    except (struct.error, ValueError, OverflowError):
        whole = False
    if not whole:
        raise FormatError(f"{path.name} is incomplete or not a COLMAP file; copy the model again")
    return b"".join(parts)


def _copy_camera(params_of: Callable[[int], int], data: bytes, start: int) -> Record:
    """A camera: id, camera model, width, height, then the parameters of the model."""
    _, model, _, _ = struct.unpack_from("<IiQQ", data, start)
    end = start + 24 + 8 * params_of(model)
    return data[start:end], end


def _copy_image(names: dict[int, bytes], data: bytes, start: int) -> Record:
    """An image: id, quaternion, translation, camera id, zero-terminated name, which is put into `names`, then
    (x, y, point id) of each keypoint."""
    end = data.index(b"\0", start + 64) + 1
    (count,) = struct.unpack_from("<Q", data, end)
    (number,) = struct.unpack_from("<I", data, start)
    names[number] = data[start + 64 : end - 1]
    _check_length(struct.unpack_from("<4d", data, start + 4), names[number])
    return data[start : start + 64] + b"%d\0" % number + NONE, end + 8 + 24 * count


def _copy_point(data: bytes, start: int) -> Record:
    """A point: id, xyz, rgb, error, then (image id, keypoint) of each observation."""
    (count,) = struct.unpack_from("<Q", data, start + 43)
    return data[start : start + 43] + NONE, start + 51 + 8 * count


def _image_lines(names: dict[int, bytes], text: bytes) -> Iterator[bytes]:
    """Two lines for each image: id, quaternion, translation, camera id, name, which may have spaces and goes
    into `names`; then its keypoints, here none."""
    lines = iter(text.splitlines())
    for line in lines:
        if not line.strip() or line.lstrip().startswith(b"#"):
            continue
        words = line.strip().split(None, 9)
        if len(words) == 10 and words[0].isdigit():  # pycolmap says what is wrong with others
            names[int(words[0])] = words[9]
            _check_length(tuple(map(_number, words[1:5])), words[9])
            line = b" ".join((*words[:9], words[0]))
        yield line
        yield b""
        if IMAGE_LINE.match(next(lines, b"")):
            raise FormatError("images.txt: has no line of keypoints after each image; export it again")


def _point_lines(text: bytes) -> Iterator[bytes]:
    """One line for each point: id, xyz, rgb, error, then its track, here none."""
    return (
        line if line.lstrip().startswith(b"#") else b" ".join(line.split()[:8]) for line in text.splitlines()
    )


def _check_length(quaternion: tuple[float, ...], name: bytes) -> None:
    """Raises FormatError if the quaternion has not the length 1."""
    length = math.hypot(*quaternion)
    if not abs(length - 1) < MAX_LENGTH_ERROR:
        shown = name.decode(errors="backslashreplace")
        raise FormatError(
            f"the rotation of {shown!r} is a quaternion of length {length:.6g} instead of 1; export the model"
            " again"
        )


def _number(word: bytes) -> float:
    try:
        return float(word)
    except ValueError:
        return math.nan
