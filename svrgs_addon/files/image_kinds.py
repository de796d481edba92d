"""The kinds of image files that are read, by their first bytes.

OpenImageIO tries all its readers on a file that the first one refuses. One of them takes over a minute for a
few gigabytes of zeros, so files of no known kind are refused before.
"""

from __future__ import annotations

import os
import re

from ..system.errors import FormatError
from .reading import readable

HEAD_BYTES = 16
MISNAMED_BYTES = 64 * 2**20  # largest file that is read although its suffix is that of another kind
# first bytes, and suffixes that OpenImageIO knows
KINDS: dict[str, tuple[re.Pattern[bytes], tuple[str, ...]]] = {
    "JPEG": (re.compile(rb"\xff\xd8\xff"), (".jpg", ".jpeg", ".jpe", ".jif", ".jfif", ".jfi")),
    "PNG": (re.compile(rb"\x89PNG"), (".png",)),
    "TIFF": (re.compile(rb"II[*+]\0|MM\0[*+]"), (".tif", ".tiff")),
    "OpenEXR": (re.compile(rb"v/1\x01"), (".exr",)),
    "WebP": (re.compile(rb"RIFF.{4}WEBP", re.DOTALL), (".webp",)),
    "BMP": (re.compile(rb"BM"), (".bmp", ".dib")),
    "PNM": (re.compile(rb"P[1-7fF]\s"), (".ppm", ".pgm", ".pbm", ".pnm", ".pfm")),
    "HDR": (re.compile(rb"#\?"), (".hdr", ".rgbe")),
}


def has_right_suffix(path: str | os.PathLike) -> bool:
    """Whether the suffix of an image file is that of its kind. Raises FormatError if it begins as no known
    kind, cannot be read, or is larger than MISNAMED_BYTES and has a wrong suffix."""
    if not os.path.isfile(path):
        raise FormatError(f"{path}: is not a file")
    with readable(path), open(path, "rb") as file:
        head = file.read(HEAD_BYTES)
        size = os.fstat(file.fileno()).st_size
    kind = next((name for name, (pattern, _) in KINDS.items() if pattern.match(head)), "")
    if not kind:
        raise FormatError(
            f"{path}: cannot be read as an image (it begins like no {', '.join(KINDS)} file); export it again"
        )
    suffixes = KINDS[kind][1]
    right = os.path.splitext(os.fspath(path))[1].lower() in suffixes
    if not right and size > MISNAMED_BYTES:
        raise FormatError(
            f"{path}: cannot be read as an image (it begins like a {kind} file); give its name the suffix"
            f" {suffixes[0]}"
        )
    return right
