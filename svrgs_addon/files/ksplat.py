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
from .reading import BROKEN, MAX_COUNT, open_splat, refuse_many, refuse_unpacking, rows_at, size_of
from .splat_format import PART, SplatFormat


def _fields(size: int, **of: tuple[str, int]) -> np.dtype:
    """Bytes of a header of this size: of each field the type, and where it begins."""
    formats, offsets = zip(*of.values(), strict=True)
    return np.dtype({"names": list(of), "formats": formats, "offsets": offsets, "itemsize": size})


HEADER = _fields(
    4096, major=("u1", 0), minor=("u1", 1), sections=("<u4", 4), count=("<u4", 16), level=("<u2", 20),
    low=("<f4", 36), high=("<f4", 40),
)  # fmt: skip
SECTION = _fields(
    1024, count=("<u4", 0), room=("<u4", 4), bucket_size=("<u4", 8), buckets=("<u4", 12), width=("<f4", 16),
    storage=("<u2", 20), steps=("<u4", 24), full=("<u4", 32), partial=("<u4", 36), degree=("<u2", 40),
)  # fmt: skip
MAX_SECTIONS = 1024
RANGE_OF_SH = 1.5  # of SH in 8 bits, to both sides, if the header has none


@dataclass(frozen=True)
class _Header:
    level: int  # of compression, 0 to 2
    sections: int
    count: int
    low: float  # SH of 0 and of 255, in 8 bits
    high: float


@dataclass(frozen=True)
class _Section:
    count: int  # Gaussians
    coefficients: int  # K
    at: int  # byte where they begin
    centres: np.ndarray  # (buckets, 3); none without compression
    ends: np.ndarray  # (buckets,) the first Gaussian after each
    step: float  # length of a step of 16 bits, and how many there are to each side
    steps: int


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


_EMPTY = _Section(0, 1, HEADER.itemsize, np.empty((0, 3), np.float32), np.empty(0, np.int64), 0.0, 1)


def _header(file: BinaryIO, max_count: int) -> _Header:
    """The header, checked. Raises FormatError (without the name of the file), as the functions below."""
    if size_of(file) < HEADER.itemsize:
        raise FormatError(
            f"is no .ksplat, or incomplete: {size_of(file):,} bytes are less than its header has; copy or"
            " export it again"
        )
    major, minor, sections, count, level, low, high = rows_at(file, 0, HEADER, 1)[0].item()
    if major != 0 or minor < 1 or level > 2:
        raise FormatError("is no .ksplat, or one of another version than 0.1")
    if sections > MAX_SECTIONS:
        raise FormatError(f"has {sections} sections, more than the limit of {MAX_SECTIONS}")
    low, high = low or -RANGE_OF_SH, high or RANGE_OF_SH
    if not (np.isfinite([low, high]).all() and low < high):
        raise FormatError(f"has a range of SH coefficients from {low:g} to {high:g}{BROKEN}")
    refuse_many(count, max_count)
    return _Header(level, sections, count, low, high)


def _sections(file: BinaryIO, header: _Header) -> Iterator[_Section]:
    """The sections that hold Gaussians."""
    at, size = HEADER.itemsize + SECTION.itemsize * header.sections, size_of(file)
    for number in range(header.sections):
        head = _within(file, HEADER.itemsize + SECTION.itemsize * number, SECTION, 1, size)[0].item()
        count, room, bucket_size, buckets, width, storage, steps, full, partial, degree = head
        if degree >= len(SH_COEFFICIENTS) or count > room:
            raise FormatError(f"has a section of SH degree {degree} with {count} of {room} Gaussians{BROKEN}")
        data_at = at + 4 * partial + storage * buckets
        end = data_at + _row(header.level, SH_COEFFICIENTS[degree]).itemsize * room
        if end > size:
            raise FormatError(f"is incomplete: {size:,} of at least {end:,} bytes; copy or export it again")
        if count:
            centres, ends = _EMPTY.centres, _EMPTY.ends
            if header.level:
                if buckets and storage != 12:
                    raise FormatError(f"has buckets of {storage} bytes instead of 12{BROKEN}")
                lengths = _within(file, at, np.dtype("<u4"), partial, size).astype(np.int64)
                centres = _within(file, at + 4 * partial, np.dtype(("<f4", 3)), buckets, size)
                if full + partial > buckets or count > full * bucket_size + int(lengths.sum()):
                    raise FormatError(f"has Gaussians without a bucket{BROKEN}")
                ends = np.cumsum(np.concatenate([np.full(full, bucket_size), lengths]))  # full ones first
            steps = steps or 32767
            yield _Section(count, SH_COEFFICIENTS[degree], data_at, centres, ends, width / 2 / steps, steps)
        at = end


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
    mean, value, rest = (("<f4", "<f4", "<f4"), ("<u2", "<f2", "<f2"), ("<u2", "<f2", "u1"))[level]
    fields = ("means", mean, 3), ("scales", value, 3), ("quats", value, 4), ("rgba", "u1", 4)
    return np.dtype([*fields, ("rest", rest, 3 * (coefficients - 1))])


def _scene(
    file: BinaryIO, header: _Header, section: _Section, start: int, count: int, coefficients: int
) -> Scene:
    """Some Gaussians of a section, with as many SH coefficients as the section with the most has."""
    dtype = _row(header.level, section.coefficients)
    rows = rows_at(file, section.at + dtype.itemsize * start, dtype, count)
    means = rows["means"].astype(np.float32)
    with np.errstate(over="ignore", invalid="ignore"):  # of a damaged file
        if header.level:
            buckets = np.searchsorted(section.ends, np.arange(start, start + count), side="right")
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


FORMAT = SplatFormat(
    name="ksplat",
    label=".ksplat",
    suffixes=(".ksplat",),
    read_parts=read_parts,
)
