"""The .ksplat format of GaussianSplats3D (mkkellogg), versions 0.1 and later, which is read only.

A header of 4096 bytes, one of 1024 bytes for each section, then the sections: the lengths of buckets that are
not full, the centres of the buckets, and the Gaussians. Compression 0 stores float32; 1 and 2 store means as
16 bits within their bucket, scales and quaternions (w, x, y, z) as float16, and SH as float16 or 8 bits. Axes
are those of 3DGS.
"""

from __future__ import annotations

import os
from collections.abc import Iterator
from dataclasses import dataclass
from typing import BinaryIO

import numpy as np

from ..scene.gaussians import SH_COEFFICIENTS, Scene
from ..system.errors import FormatError
from .quantised import logits_of, logs_of, sh_of_colors
from .reading import MAX_COUNT, open_splat, refuse_many, refuse_unpacking, rows_at, size_of
from .splat_format import PART, SplatFormat

HEADER, SECTION_HEADER = 4096, 1024  # bytes
MAX_SECTIONS = 1024
RANGE_OF_SH = 1.5  # of SH in 8 bits, to both sides, if the header has none
BROKEN = "; export it again"


@dataclass(frozen=True)
class _Header:
    level: int  # of compression, 0 to 2
    sections: int
    count: int
    low: float  # SH of 0 and of 255, in 8 bits
    high: float


@dataclass(frozen=True)
class _Section:
    """Where the parts of a section are, in bytes."""

    count: int  # Gaussians
    coefficients: int  # K
    full: int  # buckets
    lengths: np.ndarray  # of the other buckets
    bucket_size: int  # Gaussians in a full bucket
    centres: np.ndarray  # (buckets, 3)
    step: float  # length of a step of 16 bits, and how many there are to each side
    steps: int
    at: int


def read_parts(path: str | os.PathLike, max_count: int = MAX_COUNT) -> Iterator[Scene]:
    """The Gaussians in file order, in parts. Raises FormatError, which names the file."""
    with open_splat(path) as file:
        header = _header(file, max_count)
        sections = list(_sections(file, header))
        coefficients = max((section.coefficients for section in sections), default=1)
        refuse_unpacking(header.count, coefficients, max_count)
        if sum(section.count for section in sections) != header.count:
            raise FormatError(
                f"says that it holds {header.count} Gaussians, but its sections hold others{BROKEN}"
            )
        for section in sections or [_EMPTY]:
            for start in range(0, max(section.count, 1), PART):
                yield _scene(file, header, section, start, min(PART, section.count - start), coefficients)


_EMPTY = _Section(0, 1, 0, np.empty(0, np.int64), 1, np.empty((0, 3), np.float32), 0.0, 1, HEADER)


def _header(file: BinaryIO, max_count: int) -> _Header:
    """The header, checked. Raises FormatError (without the name of the file), as the functions below."""
    if size_of(file) < HEADER:
        raise FormatError(
            f"is no .ksplat, or incomplete: {size_of(file):,} bytes are less than its header has; copy or"
            " export it again"
        )
    head = rows_at(file, 0, np.dtype("u1"), HEADER)
    words, floats = head.view("<u4"), head.view("<f4")
    if head[0] != 0 or head[1] < 1 or head.view("<u2")[10] > 2:
        raise FormatError("is no .ksplat, or one of another version than 0.1")
    if words[1] > MAX_SECTIONS:
        raise FormatError(f"has {words[1]} sections, more than the limit of {MAX_SECTIONS}")
    low, high = float(floats[9]) or -RANGE_OF_SH, float(floats[10]) or RANGE_OF_SH
    if not (np.isfinite([low, high]).all() and low < high):
        raise FormatError(f"has a range of SH coefficients from {low:g} to {high:g}{BROKEN}")
    refuse_many(int(words[4]), max_count)
    return _Header(int(head.view("<u2")[10]), int(words[1]), int(words[4]), low, high)


def _sections(file: BinaryIO, header: _Header) -> Iterator[_Section]:
    """The sections that hold Gaussians."""
    at, size = HEADER + SECTION_HEADER * header.sections, size_of(file)
    for number in range(header.sections):
        head = _within(file, HEADER + SECTION_HEADER * number, np.dtype("u1"), SECTION_HEADER, size)
        words = [int(word) for word in head.view("<u4")[:11]]
        count, room, bucket_size, buckets = words[:4]
        storage, steps, full, partial = int(head.view("<u2")[10]), words[6] or 32767, words[8], words[9]
        degree = int(head.view("<u2")[20])
        if degree >= len(SH_COEFFICIENTS) or count > room:
            raise FormatError(f"has a section of SH degree {degree} with {count} of {room} Gaussians{BROKEN}")
        data_at = at + 4 * partial + storage * buckets
        end = data_at + _row(header.level, SH_COEFFICIENTS[degree]).itemsize * room
        if end > size:
            raise FormatError(f"is incomplete: {size:,} of at least {end:,} bytes; copy or export it again")
        if count:
            lengths, centres = _EMPTY.lengths, _EMPTY.centres
            if header.level:
                lengths, centres = _buckets(file, at, (partial, storage, buckets), size)
            section = _Section(
                count,
                SH_COEFFICIENTS[degree],
                full,
                lengths,
                bucket_size,
                centres,
                float(head.view("<f4")[4]) / 2 / steps,
                steps,
                data_at,
            )
            _refuse_buckets(section, header.level)
            yield section
        at = end


def _buckets(
    file: BinaryIO, at: int, sizes: tuple[int, int, int], size: int
) -> tuple[np.ndarray, np.ndarray]:
    """Lengths of the buckets that are not full, and the centres of all."""
    partial, storage, buckets = sizes
    if buckets and storage != 12:
        raise FormatError(f"has buckets of {storage} bytes instead of 12{BROKEN}")
    lengths = _within(file, at, np.dtype("<u4"), partial, size).astype(np.int64)
    return lengths, _within(file, at + 4 * partial, np.dtype(("<f4", 3)), buckets, size)


def _refuse_buckets(section: _Section, level: int):
    """Raises FormatError if a Gaussian has no bucket."""
    if not level:
        return
    held = section.full * section.bucket_size + int(section.lengths.sum())
    if section.count > held or section.full + len(section.lengths) > len(section.centres):
        raise FormatError(f"has Gaussians without a bucket{BROKEN}")


def _within(file: BinaryIO, at: int, dtype: np.dtype, count: int, size: int) -> np.ndarray:
    """`count` values from a place on. Raises FormatError before allocating if `size` bytes end before."""
    if at + dtype.itemsize * count > size:
        raise FormatError(
            f"is incomplete: {size:,} of at least {at + dtype.itemsize * count:,} bytes; copy or export it"
            " again"
        )
    return rows_at(file, at, dtype, count)


def _row(level: int, coefficients: int) -> np.dtype:
    """The layout of a Gaussian."""
    mean, value = ("<f4", "<f4") if level == 0 else ("<u2", "<f2")
    rest = ("<f4", "<f2", "u1")[level]
    return np.dtype(
        [
            ("means", mean, 3),
            ("scales", value, 3),
            ("quats", value, 4),
            ("rgba", "u1", 4),
            ("rest", rest, 3 * (coefficients - 1)),
        ]
    )


def _scene(
    file: BinaryIO, header: _Header, section: _Section, start: int, count: int, coefficients: int
) -> Scene:
    """Some Gaussians of a section, with as many SH coefficients as the section with the most has."""
    dtype = _row(header.level, section.coefficients)
    rows = rows_at(file, section.at + dtype.itemsize * start, dtype, count)
    means = rows["means"].astype(np.float32)
    with np.errstate(over="ignore", invalid="ignore"):  # of a damaged file
        if header.level:
            buckets = _bucket_of(section, np.arange(start, start + count))
            means = (means - section.steps) * np.float32(section.step) + section.centres[buckets]
    sh = np.zeros((count, coefficients, 3), np.float32)
    sh[:, 0] = sh_of_colors(rows["rgba"][:, :3].astype(np.float32) / 255)
    rest = rows["rest"].astype(np.float32)
    if header.level == 2:
        rest = rest * np.float32((header.high - header.low) / 255) + np.float32(header.low)
    # each band has red, green, blue in turn
    for degree in range(1, SH_COEFFICIENTS.index(section.coefficients) + 1):
        first, last = SH_COEFFICIENTS[degree - 1], SH_COEFFICIENTS[degree]
        band = rest[:, 3 * (first - 1) : 3 * (last - 1)].reshape(count, 3, last - first)
        sh[:, first:last] = band.transpose(0, 2, 1)
    logs, logits = logs_of(rows["scales"].astype(np.float32)), logits_of(rows["rgba"][:, 3])
    return Scene.of(means, logs, rows["quats"], logits, sh)


def _bucket_of(section: _Section, rows: np.ndarray) -> np.ndarray:
    """The bucket of each Gaussian of the section: full ones come first."""
    full = np.arange(1, section.full + 1) * section.bucket_size
    ends = np.concatenate([full, section.full * section.bucket_size + np.cumsum(section.lengths)])
    return np.searchsorted(ends, rows, side="right")


FORMAT = SplatFormat(
    name="ksplat",
    label=".ksplat",
    suffixes=(".ksplat",),
    read_parts=read_parts,
)
