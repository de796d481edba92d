"""How SPZ packs its streams of bytes.

Version 4: a header of 32 bytes, records of extensions, a table with the sizes of each stream, packed and
unpacked (8 bytes each), and the streams, each a frame of Zstandard. Versions 1 to 3: one gzip of a header of
16 bytes and all streams.
"""

from __future__ import annotations

import os
import struct
import zlib
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass

import numpy as np

from ..scene.gaussians import SH_COEFFICIENTS
from ..system.errors import FormatError, SceneError
from . import zstd
from .reading import INCOMPLETE, refuse_unpacking

MAGIC, GZIP = b"NGSP", b"\x1f\x8b"
NEWEST, SMALLEST_THREE = 4, 3  # versions: the newest one; the first one whose rotations have 32 bits
# of any version; what follows it: a byte, or, in version 4, the streams and where their table begins
HEAD, TABLE = struct.Struct("<4sIIBBB"), struct.Struct("<BI12x")
ENTRY = struct.Struct("<QQ")
ANTIALIASED, EXTENSIONS = 1, 2  # flags
ADOBE_AXES = 0xADBE0003  # type of an extension after which axes may be others
MAX_DEGREE = 4  # of SH; that beyond 3 is not read
# most bytes that a byte of the file can hold: in Deflate 258 for 2 bits, in Zstandard 128 kB for 4 bytes
DEFLATED, ZSTANDARD = 1_032, 1 << 15
LEVEL, GZIP_LEVEL = 9, 6  # of compression
# of Zstandard: short matches in SH cost time, and bytes too
FOR_SH = {"strategy": 4, "search_log": 4, "min_match": 6}


@dataclass(frozen=True)
class Header:
    """What the header of any version says."""

    version: int
    count: int
    degree: int  # of SH, 0 to 4
    fraction_bits: int
    antialiased: bool

    @property
    def coefficients(self) -> int:
        """SH coefficients per channel that are read, K."""
        return SH_COEFFICIENTS[min(self.degree, 3)]

    def widths(self) -> dict[str, int]:
        """Bytes of a Gaussian in each stream, in their order."""
        positions, rotations = 6 if self.version == 1 else 9, 4 if self.version >= SMALLEST_THREE else 3
        return {
            "positions": positions,
            "alphas": 1,
            "colors": 3,
            "scales": 3,
            "rotations": rotations,
            "sh": 3 * ((self.degree + 1) ** 2 - 1),
        }


def streams(data: bytes, max_count: int) -> tuple[Header, dict[str, np.ndarray]]:
    """The header and the streams, (N, bytes) uint8 each, of the bytes of a file. Raises FormatError (without
    the name of the file), SceneError."""
    if data[:2] == GZIP:
        return _gunzipped(data, max_count)
    start = HEAD.size + TABLE.size
    header, flags = _header(data[:start], start, (NEWEST,), len(data) * ZSTANDARD, max_count)
    number, table = TABLE.unpack_from(data, HEAD.size)
    if flags & EXTENSIONS:
        _refuse_other_axes(data[start:table])
    widths = {name: width for name, width in header.widths().items() if width * header.count}
    if number != len(widths) or table < start or table + ENTRY.size * number > len(data):
        raise FormatError(
            f"has {number} streams, or a table at byte {table}, that do not fit its header{INCOMPLETE}"
        )
    rows = _unpacked(data, table, widths, header.count)
    empty = {name: np.empty((header.count, width), np.uint8) for name, width in header.widths().items()}
    return header, empty | rows  # a file leaves out streams without bytes


def packed(header: Header, rows: dict[str, np.ndarray], path: str | os.PathLike) -> bytes:
    """The bytes of a file with these streams, (N, bytes) uint8 each. Raises SceneError, naming the file."""
    names = [name for name, width in header.widths().items() if width * header.count]
    contents = [np.ascontiguousarray(rows[name]).data.cast("B") for name in names]
    facts = header.version, header.count, header.degree, header.fraction_bits
    head = HEAD.pack(MAGIC, *facts, ANTIALIASED * header.antialiased)
    if header.version < NEWEST:
        packer = zlib.compressobj(GZIP_LEVEL, wbits=16 + zlib.MAX_WBITS)
        return b"".join([packer.compress(head + b"\0"), *map(packer.compress, contents), packer.flush()])
    if not zstd.available():
        raise SceneError(f"{path}: cannot be written, {zstd.MISSING}")
    compress = lambda name, content: zstd.compress(content, LEVEL, **(FOR_SH if name == "sh" else {}))
    with ThreadPoolExecutor(os.cpu_count()) as threads:
        frames = list(threads.map(compress, names, contents))
    head += TABLE.pack(len(frames), HEAD.size + TABLE.size)
    table = [ENTRY.pack(len(frame), len(content)) for frame, content in zip(frames, contents, strict=True)]
    return b"".join([head, *table, *frames])


def _header(head: bytes, size: int, versions: Sequence[int], held: int, max_count: int) -> tuple[Header, int]:
    """The header in the first `size` bytes, and the flags. held: the most bytes that the streams can have.
    Raises FormatError, also for values that no writer sets, and more Gaussians than can be in the file."""
    if len(head) < size or head[:4] != MAGIC:
        raise FormatError(f"is no SPZ, or incomplete{INCOMPLETE}")
    _, version, count, degree, bits, flags = HEAD.unpack_from(head)
    if version not in versions:
        raise FormatError(f"is an SPZ of version {version}; versions 1 to {NEWEST} are read")
    header = Header(version, count, degree, bits, bool(flags & ANTIALIASED))
    if degree > MAX_DEGREE or bits > 30:
        raise FormatError(
            f"has SH of degree {degree} or {bits} bits of fraction, which no program writes{INCOMPLETE}"
        )
    if count * sum(header.widths().values()) > held:
        raise FormatError(f"is too small for the {count:,} Gaussians that its header names{INCOMPLETE}")
    refuse_unpacking(count, header.coefficients, max_count)
    return header, flags


def _refuse_other_axes(records: bytes):
    """Raises FormatError if an extension may change the axes of the scene; others are ignored."""
    at = 0
    while at + 8 <= len(records):
        kind, length = struct.unpack_from("<II", records, at)
        if kind == ADOBE_AXES:
            raise FormatError(
                "has axes of its own (an extension by Adobe), which are not read; export it without them"
            )
        at += 8 + length


def _unpacked(data: bytes, table: int, widths: dict[str, int], count: int) -> dict[str, np.ndarray]:
    """The streams of version 4. Raises FormatError, SceneError."""
    if widths and not zstd.available():
        raise FormatError(f"cannot be read, {zstd.MISSING}")
    at, frames = table + ENTRY.size * len(widths), {}
    for number, (name, width) in enumerate(widths.items()):
        length, size = ENTRY.unpack_from(data, table + ENTRY.size * number)
        if size != width * count or length > len(data) - at:
            raise FormatError(f"has a stream of {name} of another size than its header says{INCOMPLETE}")
        frames[name] = (data[at : at + length], size)
        at += length
    if at != len(data):
        raise FormatError(f"has {len(data) - at} bytes more than its streams{INCOMPLETE}")
    with ThreadPoolExecutor() as threads:
        contents = list(threads.map(lambda frame: zstd.decompress(*frame), frames.values()))
    return {
        name: np.frombuffer(content, np.uint8).reshape(count, -1)
        for name, content in zip(frames, contents, strict=True)
    }


def _gunzipped(data: bytes, max_count: int) -> tuple[Header, dict[str, np.ndarray]]:
    """Header and streams of versions 1 to 3. Raises FormatError."""
    unpacker = zlib.decompressobj(16 + zlib.MAX_WBITS)
    try:
        size = HEAD.size + 1
        head = unpacker.decompress(data, size)
        header, _ = _header(head, size, range(1, NEWEST), len(data) * DEFLATED, max_count)
        needed = header.count * sum(header.widths().values())
        content = unpacker.decompress(unpacker.unconsumed_tail, needed) if needed else b""
    except zlib.error as error:
        raise FormatError(f"is damaged ({error}){INCOMPLETE}") from None
    if len(content) < needed:
        raise FormatError(f"is incomplete: {len(content):,} of {needed:,} bytes are in it{INCOMPLETE}")
    rows, at = {}, 0
    for name, width in header.widths().items():
        length = width * header.count
        rows[name] = np.frombuffer(content, np.uint8, length, at).reshape(header.count, width)
        at += length
    return header, rows
