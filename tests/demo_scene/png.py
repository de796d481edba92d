"""Writes PNG files."""

import struct
import zlib
from pathlib import Path

import numpy as np

SIGNATURE = b"\x89PNG\r\n\x1a\n"


def write(path: Path, rgb: np.ndarray) -> None:
    """(H, W, 3) uint8, first row on top."""
    height, width = rgb.shape[:2]
    rows = b"".join(b"\0" + row.tobytes() for row in rgb)  # each led by its filter: none
    head = struct.pack(">2I5B", width, height, 8, 2, 0, 0, 0)
    path.write_bytes(
        SIGNATURE + _chunk(b"IHDR", head) + _chunk(b"IDAT", zlib.compress(rows)) + _chunk(b"IEND", b"")
    )


def without_notes(data: bytes) -> bytes:
    """A PNG file without the chunks an image can do without: Cycles notes its render times there."""
    kept, at = data[:8], 8  # after the signature: length, type, content, checksum
    while at < len(data):
        end = at + 12 + int.from_bytes(data[at : at + 4], "big")
        if data[at + 4 : at + 8] in (b"IHDR", b"IDAT", b"IEND"):
            kept += data[at:end]
        at = end
    return kept


def _chunk(name: bytes, content: bytes) -> bytes:
    return struct.pack(">I", len(content)) + name + content + struct.pack(">I", zlib.crc32(name + content))
