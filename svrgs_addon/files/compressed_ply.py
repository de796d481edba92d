"""The compressed PLY of PlayCanvas: 256 Gaussians in a row share ranges, within which their values have 8 to
11 bits.

    chunk     ranges of position, log-scale and base colour; early files have no ranges of the colour, which
              is then 0 to 1
    vertex    packed_position, packed_scale: 11, 10, 11 bits; packed_rotation: of (w, x, y, z), the position
              of the largest component, 2 bits, and the others, 10 bits each; packed_color: red, green, blue,
              opacity, 8 bits each
    sh        f_rest_0 ..., 8 bits each, from -4 to 4, in the order of 3DGS; left out for degree 0

Axes are those of 3DGS. A writer orders the Gaussians by their places, so that ranges are small.
"""

from __future__ import annotations

import os
from collections.abc import Iterator
from dataclasses import dataclass
from typing import BinaryIO

import numpy as np

from ..scene.gaussians import SH_COEFFICIENTS, Scene
from ..scene.morton_order import morton_order
from ..system.errors import FormatError
from .atomic import atomic_write, check_space
from .ply_header import MAX_HEADER_BYTES, Header, format_header, is_mip, parse_header, written_comments
from .quantised import (
    alphas_of,
    clipped,
    colors_of_sh,
    logits_of,
    quats_of_three,
    sh_of_colors,
    three_of_quats,
    widest_logs,
)
from .reading import MAX_COUNT, open_splat, refuse_unpacking, rows_at, size_of
from .splat_format import SplatFormat

CHUNK = 256  # Gaussians
PART = 64 * CHUNK  # Gaussians that are converted together
POSITION_BITS = SCALE_BITS = (11, 10, 11)
PACKED = ("packed_position", "packed_rotation", "packed_scale", "packed_color")
RANGES = tuple(
    f"{end}_{name}"
    for group in (("x", "y", "z"), ("scale_x", "scale_y", "scale_z"), ("r", "g", "b"))
    for end in ("min", "max")
    for name in group
)
WITHOUT_COLOR = 12  # ranges in files of the first version
LARGEST_LOG_SCALE = 20.0  # of the ranges
MOST_SH = 4.0  # of coefficients of degree 1 to 3
MAX_COARSE = 0.05  # share of the Gaussians smaller than a step of their positions, at most
HALF_SQRT2 = np.float32(0.5**0.5)
BROKEN = "; export the file again"
OTHER = {  # in an element of the header
    "chunk": "other ranges in its chunks, or another number of them,",
    "vertex": "other packed values",
    "sh": "other SH coefficients",
}


@dataclass(frozen=True)
class _Layout:
    """Where the parts of a file are, as offsets in bytes."""

    count: int
    ranges: int  # columns of element chunk
    coefficients: int  # K, SH coefficients per channel
    chunks_at: int  # the size of the header
    comments: tuple[str, ...] = ()

    @property
    def rows_at(self) -> int:
        return self.chunks_at + 4 * self.ranges * -(-self.count // CHUNK)

    @property
    def sh_at(self) -> int:
        return self.rows_at + 4 * len(PACKED) * self.count

    @property
    def end(self) -> int:
        return self.sh_at + self.count * 3 * (self.coefficients - 1)


def sniff(head: bytes) -> bool:
    """Whether a file that begins with these bytes is a compressed PLY."""
    return head.startswith(b"ply") and b"\nelement chunk " in head


def read_parts(path: str | os.PathLike, max_count: int = MAX_COUNT) -> Iterator[Scene]:
    """The Gaussians in file order, in parts. Raises FormatError, which names the file."""
    with open_splat(path) as file:
        layout = _checked(file, max_count)
        for start in range(0, max(layout.count, 1), PART):
            yield _part(file, layout, start, min(PART, layout.count - start))


def write(path: str | os.PathLike, scene: Scene):
    """Writes the scene atomically, with its Gaussians in Morton order. Raises SceneError."""
    head, layout = _head(scene)
    rest = 3 * (scene.sh.shape[1] - 1)
    check_space(path, layout.end)
    order = morton_order(scene.means)
    with atomic_write(path) as file:
        file.write(head)
        for start in range(0, scene.count, PART):
            part = scene.select(order[start : start + PART])
            ranges, packed = _packed(part)
            pieces = {
                layout.chunks_at + ranges.itemsize * len(RANGES) * (start // CHUNK): ranges,
                layout.rows_at + packed.itemsize * len(PACKED) * start: packed,
            }
            if rest:
                channels = part.sh[:, 1:].transpose(0, 2, 1).reshape(part.count, rest)
                stored = np.floor((channels / 8 + np.float32(0.5)) * 256).clip(0, 255).astype(np.uint8)
                pieces[layout.sh_at + rest * start] = stored
            for at, piece in pieces.items():
                file.seek(at)
                file.write(np.ascontiguousarray(piece).data)


def limits(scene: Scene) -> list[str]:
    """A sentence if Gaussians are smaller than the steps of their positions, and one if SH are clipped."""
    order = morton_order(scene.means)
    means, starts = scene.means[order], np.arange(0, scene.count, CHUNK)
    extents = np.maximum.reduceat(means, starts) - np.minimum.reduceat(means, starts)
    steps = (extents / (2.0 ** np.array(POSITION_BITS) - 1)).max(axis=1).repeat(CHUNK)[: scene.count]
    coarse = int((steps > np.exp(widest_logs(scene)[order])).sum())
    sentences = clipped(scene, "a compressed PLY", MOST_SH)
    if coarse <= MAX_COARSE * scene.count:
        return sentences
    return [
        f"the positions of {coarse:,} Gaussians are stored in steps larger than these are, because some lie"
        " far away: remove those first (svrgs select), or write another format",
        *sentences,
    ]


def file_size(scene: Scene) -> int:
    """Size in bytes of the file that write() would make."""
    return _head(scene)[1].end


def _head(scene: Scene) -> tuple[bytes, _Layout]:
    """The header that write() would write, and the layout of its file."""
    elements = _elements(scene.count, len(RANGES), 3 * (scene.sh.shape[1] - 1))
    head = format_header(written_comments(scene), *elements)
    return head, _Layout(scene.count, len(RANGES), scene.sh.shape[1], len(head))


def _elements(count: int, ranges: int, rest: int) -> list[tuple[str, int, list[tuple[str, str]]]]:
    """Those of the header, as format_header() takes them. ranges, rest: properties of chunk and of sh."""
    elements = [
        ("chunk", -(-count // CHUNK), [(name, "f4") for name in RANGES[:ranges]]),
        ("vertex", count, [(name, "u4") for name in PACKED]),
        ("sh", count, [(f"f_rest_{k}", "u1") for k in range(rest)]),
    ]
    return elements if rest else elements[:2]


def _checked(file: BinaryIO, max_count: int) -> _Layout:
    """Checks header and size of the file. Raises FormatError (without the name of the file)."""
    header = parse_header(file.read(MAX_HEADER_BYTES))
    count, ranges, coefficients = _checked_elements(header)
    refuse_unpacking(count, coefficients, max_count)
    layout = _Layout(count, ranges, coefficients, header.size, header.comments)
    if (size := size_of(file)) != layout.end:
        problem = "is incomplete" if size < layout.end else "is too long"
        raise FormatError(f"{problem}: {size:,} of {layout.end:,} bytes; copy or export it again")
    return layout


def _checked_elements(header: Header) -> tuple[int, int, int]:
    """(count, columns of ranges, K) of a header with the elements of this format. Raises FormatError."""
    if header.encoding != "binary_little_endian":
        raise FormatError(f"is a compressed PLY in {header.encoding}, which no program writes{BROKEN}")
    names = [element.name for element in header.elements]
    if names not in (["chunk", "vertex"], ["chunk", "vertex", "sh"]):
        raise FormatError(
            f"has the elements {', '.join(names)}; a compressed PLY has chunk, vertex and perhaps sh{BROKEN}"
        )
    chunk, vertex, *sh = header.elements
    ranges = WITHOUT_COLOR if len(chunk.properties) == WITHOUT_COLOR else len(RANGES)
    rest = len(sh[0].properties) if sh else 0
    for found, expected in zip(header.elements, _elements(vertex.count, ranges, rest), strict=False):
        if (found.name, found.count, found.properties) != expected or found.list_property:
            raise FormatError(f"has {OTHER[found.name]} than a compressed PLY{BROKEN}")
    if rest % 3 or 1 + rest // 3 not in SH_COEFFICIENTS:
        raise FormatError(f"has {rest} f_rest properties; SH degrees 0 to 3 have 0, 9, 24 or 45")
    return vertex.count, ranges, 1 + rest // 3


def _part(file: BinaryIO, layout: _Layout, start: int, count: int) -> Scene:
    """The Gaussians from `start` on, which begins a chunk."""
    first, chunks, rest = start // CHUNK, -(-count // CHUNK), 3 * (layout.coefficients - 1)
    chunk, row = np.dtype(("<f4", layout.ranges)), np.dtype(("<u4", len(PACKED)))
    ranges = rows_at(file, layout.chunks_at + chunk.itemsize * first, chunk, chunks)
    ranges = np.repeat(ranges, CHUNK, axis=0)[:count]
    position, rotation, scale, color = rows_at(file, layout.rows_at + row.itemsize * start, row, count).T
    colors = _unpacked(color >> 8, (8, 8, 8))
    sh = np.empty((count, layout.coefficients, 3), np.float32)
    if layout.ranges > WITHOUT_COLOR:
        colors = _within(colors, ranges[:, 12:15], ranges[:, 15:18])
    sh[:, 0] = sh_of_colors(colors)
    if rest:
        stored = rows_at(file, layout.sh_at + rest * start, np.dtype(("u1", rest)), count)
        sh[:, 1:] = _SH_VALUES[stored].reshape(count, 3, -1).transpose(0, 2, 1)
    three = (_unpacked(rotation, (10, 10, 10)) - np.float32(0.5)) / HALF_SQRT2
    return Scene(
        _within(_unpacked(position, POSITION_BITS), ranges[:, 0:3], ranges[:, 3:6]),
        _within(_unpacked(scale, SCALE_BITS), ranges[:, 6:9], ranges[:, 9:12]),
        quats_of_three(three, rotation >> 30),
        logits_of(color & 255),
        sh,
        antialiased=is_mip(layout.comments),
        comments=layout.comments,
    )


_SH_VALUES = (
    (np.where(np.arange(256) % 255 == 0, np.arange(256) / 255, (np.arange(256) + 0.5) / 256) - 0.5) * 8
).astype(np.float32)


def _packed(scene: Scene) -> tuple[np.ndarray, np.ndarray]:
    """The ranges (C, 18) float32 and the packed values (N, 4) uint32."""
    starts = np.arange(0, scene.count, CHUNK)
    logs = np.clip(scene.log_scales, -LARGEST_LOG_SCALE, LARGEST_LOG_SCALE)
    columns, ranges, shares = (scene.means, logs, colors_of_sh(scene.sh[:, 0])), [], []
    for values in columns:
        low, high = np.minimum.reduceat(values, starts), np.maximum.reduceat(values, starts)
        ranges += [low, high]
        width = np.repeat(high - low, CHUNK, axis=0)[: scene.count]
        shares.append((values - np.repeat(low, CHUNK, axis=0)[: scene.count]) / np.where(width > 0, width, 1))
    three, largest = three_of_quats(scene.quats)
    rotation = _bits(three * HALF_SQRT2 + np.float32(0.5), (10, 10, 10)) | (largest.astype(np.uint32) << 30)
    color = (_bits(shares[2], (8, 8, 8)) << 8) | alphas_of(scene.opacity_logits)
    packed = np.column_stack([_bits(shares[0], POSITION_BITS), rotation, _bits(shares[1], SCALE_BITS), color])
    return np.concatenate(ranges, axis=1).astype("<f4"), packed.astype("<u4")


def _bits(shares: np.ndarray, bits: tuple[int, int, int]) -> np.ndarray:
    """(N,) uint32: shares (N, 3), 0 to 1, rounded to so many bits each, the first in the highest bits."""
    packed = np.zeros(len(shares), np.uint32)
    for share, width in zip(shares.T, bits, strict=True):
        whole = np.clip(np.rint(share * (2**width - 1)), 0, 2**width - 1).astype(np.uint32)
        packed = (packed << np.uint32(width)) | whole
    return packed


def _unpacked(packed: np.ndarray, bits: tuple[int, int, int]) -> np.ndarray:
    """The inverse of _bits(): (N, 3) float32, 0 to 1."""
    shares, shift = np.empty((len(packed), 3), np.float32), sum(bits)
    for k, width in enumerate(bits):
        shift -= width
        whole = (packed >> np.uint32(shift)) & np.uint32(2**width - 1)
        shares[:, k] = whole * np.float32(1 / (2**width - 1))
    return shares


def _within(shares: np.ndarray, low: np.ndarray, high: np.ndarray) -> np.ndarray:
    """Values at these shares of ranges. Ranges of a damaged file may be infinite."""
    with np.errstate(over="ignore", invalid="ignore"):
        return low * (1 - shares) + high * shares


FORMAT = SplatFormat(
    name="compressed-ply",
    label="Compressed PLY",
    suffixes=(".compressed.ply", ".ply"),
    sniff=sniff,
    read_parts=read_parts,
    write=write,
    size=file_size,
    limits=limits,
    carries=("antialiased",),
)
