"""SPZ (Niantic), versions 1 to 4. Versions 2 to 4 are written; 4, the newest, if nothing else is asked for.

Streams of bytes, one for each kind of value, in this order:

    positions    3 x 24 bits, signed: multiples of 2^-f, f from the header (version 1: 3 x float16)
    alphas       8 bits, from 0 to 1
    colors       3 x 8 bits: SH of degree 0, (value / 255 - 1/2) / 0.15
    scales       3 x 8 bits: logarithm, value / 16 - 10
    rotations    version 3 on: 32 bits, the position of the largest component of (x, y, z, w), and the others,
                 a sign and 9 bits each; before: 3 x 8 bits, x, y, z with w >= 0
    sh           8 bits, (value - 128) / 128, of each coefficient the three channels

Axes are right, up, back: y and z have the opposite sign of those of 3DGS. The streams are packed as
spz_container.py says.
"""

from __future__ import annotations

import logging
import os
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace

import numpy as np

from ..scene.gaussians import Scene
from ..scene.morton_order import morton_order
from . import zstd
from .atomic import check_space, write_bytes
from .axes import turned_over
from .memory_mapped import array_for
from .quantised import (
    COARSE,
    MAX_BEYOND,
    alphas_of,
    clipped,
    logits_of,
    picture_weights,
    quats_of_three,
    small_scale,
    three_of_quats,
    to_uint8,
    widest_logs,
)
from .reading import MAX_COUNT, open_splat
from .sh_rounding import SeenFrom, rounded
from .splat_format import PART, SplatFormat, by_parts
from .spz_container import GZIP, MAGIC, NEWEST, SMALLEST_THREE, Header, packed, streams

FRACTION_BITS = 12  # of positions, at least where the scene is small enough
LARGEST_POSITION = 2**23 - 1
FINER = 16  # steps of a position, at least, in the scale of a small Gaussian
MAX_FRACTION_BITS = 24
COLOR, SCALE_STEPS, SMALLEST_SCALE = 0.15, 16, -10
# of 256, between written values of SH of a Gaussian with weight 1 (picture_weights; docs/formats.md)
SH_STEP = 3
SEEN = 2  # times as large where it is known from where a Gaussian is seen (sh_rounding.py)
FINEST_SH, COARSEST_SH = 1, 128  # the same of any Gaussian
SQRT_HALF = np.float32(0.5**0.5)


def read_parts(path: str | os.PathLike, max_count: int = MAX_COUNT) -> Iterator[Scene]:
    """The Gaussians in file order, in parts. Raises FormatError, which names the file."""
    with open_splat(path) as file:
        yield from parts_of(file.read(), max_count)


def parts_of(data: bytes, max_count: int = MAX_COUNT) -> Iterator[Scene]:
    """The Gaussians in the bytes of a file, in parts. Raises FormatError (without a name), SceneError."""
    header, stored = streams(data, max_count)
    if header.degree > 3:
        logging.warning("spherical harmonics of degree %d are read up to degree 3", header.degree)
    yield from by_parts(
        lambda part: _scene(header, {name: rows[part] for name, rows in stored.items()}), header.count
    )


def write(
    path: str | os.PathLike,
    scene: Scene,
    version: int = 0,
    quantise: float = 1.0,
    seen: SeenFrom | None = None,
):
    """Writes the scene atomically, with its Gaussians in Morton order, as this version of the format. 0: the
    newest, but 3 for a scene without SH, which is as small, and which Blender 5.3 does not read as version 4.
    quantise: factor on the steps of SH. seen: from where, if it is known: steps are SEEN times as large, and
    cause less error. Raises SceneError."""
    newest = NEWEST if scene.sh_degree else SMALLEST_THREE
    data = content(path, scene, version or newest, quantise, seen=seen)
    check_space(path, len(data))
    write_bytes(path, data)


def content(
    path: str | os.PathLike,
    scene: Scene,
    version: int,
    quantise: float = 1.0,
    turned: Callable[[Scene], Scene] = turned_over,
    seen: SeenFrom | None = None,
) -> bytes:
    """The bytes that write() would write. path: of errors, and beside it lies what does not fit into memory.
    turned: to the axes of the file. Raises SceneError."""
    if not scene.sh_degree:
        seen = None
    header = Header(version, scene.count, scene.sh_degree, fraction_bits(*_extent(scene)), scene.antialiased)
    stored = {
        name: array_for((scene.count, width), np.uint8, path) for name, width in header.widths().items()
    }
    with ThreadPoolExecutor(os.cpu_count()) as threads:
        ordered = threads.submit(morton_order, scene.means)
        steps = sh_steps(picture_weights(scene), quantise * (SEEN if seen else 1))
        order = ordered.result()

        def convert(start: int):
            some = order[start : start + PART]
            part = scene.select(some)
            if seen:
                part = replace(part, sh=_rounded(part, steps[some], seen.select(some)))
            for name, rows in _rows(header, turned(part), steps[some]).items():
                stored[name][start : start + PART] = rows

        list(threads.map(convert, range(0, scene.count, PART)))
    return packed(header, stored, path)


def fraction_bits(largest: float, small: float) -> int:
    """Bits of the fraction of positions: FINER steps in small Gaussians, as the largest position allows."""
    fitting = int(np.floor(np.log2(LARGEST_POSITION / max(largest, 1e-30))))
    wanted = int(np.ceil(np.log2(FINER / max(small, 1e-30))))
    return max(0, min(max(wanted, FRACTION_BITS), fitting, MAX_FRACTION_BITS))


def limits(scene: Scene) -> list[str]:
    """A sentence if steps of positions show, and one if scales are beyond those that an SPZ can hold."""
    largest, small = _extent(scene)
    sentences, step = [], 2.0 ** -fraction_bits(largest, small)
    if step > small / COARSE or largest > LARGEST_POSITION * step:
        sentences.append(
            f"positions are stored in steps of {step:g}, because some lie {largest:g} away, and small"
            f" Gaussians have a scale of {small:g}: remove those far away first (svrgs select), or write"
            " another format"
        )
    low, high = SMALLEST_SCALE, SMALLEST_SCALE + 255 / SCALE_STEPS
    widest = widest_logs(scene)
    beyond = int(((widest < low) | (widest > high)).sum())
    if beyond > MAX_BEYOND * scene.count:
        sentences.append(
            f"{beyond:,} Gaussians are smaller than {np.exp(low):.1g} or larger than {np.exp(high):.3g}, the"
            " limits of an SPZ: scale the scene first"
        )
    return sentences + clipped(scene, "an SPZ", 1.0, 0.5 / COLOR)


def _extent(scene: Scene) -> tuple[float, float]:
    """The largest coordinate, and the scale of small Gaussians."""
    largest = np.abs(scene.means).max(initial=0)
    if not np.isfinite(largest):
        largest = np.abs(scene.means[np.isfinite(scene.means).all(axis=1)]).max(initial=0)
    return float(largest), small_scale(scene)


def _scene(header: Header, stored: dict[str, np.ndarray]) -> Scene:
    """The Gaussians of some rows of the streams."""
    count = len(stored["alphas"])
    sh = np.empty((count, header.coefficients, 3), np.float32)
    sh[:, 0] = _sh_of_colors(stored["colors"])
    rest = stored["sh"].reshape(count, stored["sh"].shape[1] // 3, 3)[:, : header.coefficients - 1]
    sh[:, 1:] = (rest.astype(np.float32) - 128) / 128
    logs = stored["scales"].astype(np.float32) / SCALE_STEPS + SMALLEST_SCALE
    means, quats = _positions(header, stored["positions"]), _quats(header, stored["rotations"])
    logits = logits_of(stored["alphas"][:, 0])
    return turned_over(Scene(means, logs, quats, logits, sh, antialiased=header.antialiased))


def _positions(header: Header, stored: np.ndarray) -> np.ndarray:
    if header.version == 1:
        return np.ascontiguousarray(stored).view("<f2").astype(np.float32)
    low = stored.reshape(len(stored), 3, 3).astype(np.int32)
    whole = low[:, :, 0] | (low[:, :, 1] << 8) | (low[:, :, 2] << 16)
    return ((whole ^ 0x800000) - 0x800000).astype(np.float32) * np.float32(2.0**-header.fraction_bits)


def _quats(header: Header, stored: np.ndarray) -> np.ndarray:
    """(N, 4) w x y z."""
    if header.version < SMALLEST_THREE:
        xyz = stored.astype(np.float32) / np.float32(127.5) - 1
        w = np.sqrt(np.maximum(0, 1 - np.square(xyz).sum(axis=1)))
        return np.column_stack([w, xyz])
    whole = np.ascontiguousarray(stored).view("<u4")[:, 0]
    three = np.empty((len(whole), 3), np.float32)
    for k in range(3):  # the last component is in the lowest bits
        part = whole >> np.uint32(10 * (2 - k))
        size = (part & np.uint32(511)).astype(np.float32) * (SQRT_HALF / 511)
        three[:, k] = np.where(part & np.uint32(512), -size, size)
    xyzw = quats_of_three(three, whole >> np.uint32(30))
    return np.column_stack([xyzw[:, 3], xyzw[:, :3]])


def _rows(header: Header, scene: Scene, steps: np.ndarray) -> dict[str, np.ndarray]:
    """The rows of the streams, (N, bytes) uint8. scene: in the axes of the file."""
    positions = np.rint(scene.means.astype(np.float64) * 2.0**header.fraction_bits)
    whole = np.clip(positions, -LARGEST_POSITION, LARGEST_POSITION).astype("<i4")
    rest = 128 + _in_steps(scene.sh[:, 1:], steps[:, None, None])
    return {
        "positions": whole.view(np.uint8).reshape(-1, 3, 4)[:, :, :3].reshape(-1, 9),
        "alphas": alphas_of(scene.opacity_logits)[:, None],
        "colors": _colors(scene.sh[:, 0]),
        "scales": to_uint8((scene.log_scales - SMALLEST_SCALE) * SCALE_STEPS),
        "rotations": _rotations(header, scene.quats),
        "sh": rest.astype(np.uint8).reshape(scene.count, -1),
    }


def _rotations(header: Header, quats: np.ndarray) -> np.ndarray:
    xyzw = np.column_stack([quats[:, 1:], quats[:, 0]])
    three, largest = three_of_quats(xyzw)
    if header.version < SMALLEST_THREE:
        unit = quats_of_three(three, largest)
        return to_uint8(
            unit[:, :3] * np.where(unit[:, 3:] < 0, -1, 1) * np.float32(127.5) + np.float32(127.5)
        )
    whole = largest.astype(np.uint32)
    for k in range(3):
        size = np.minimum(np.rint(np.abs(three[:, k]) * (511 / SQRT_HALF)), 511).astype(np.uint32)
        whole = (whole << np.uint32(10)) | ((three[:, k] < 0).astype(np.uint32) << np.uint32(9)) | size
    return whole.astype("<u4")[:, None].view(np.uint8)


def sh_steps(weights: np.ndarray, quantise: float = 1.0) -> np.ndarray:
    """Steps of 256 between the values of SH of each Gaussian, (N,) float32, powers of two: all of them cause
    about the same error in a picture."""
    with np.errstate(divide="ignore"):
        steps = np.exp2(np.rint(np.log2(quantise * SH_STEP / weights**0.25)))
    return np.clip(steps, FINEST_SH, COARSEST_SH).astype(np.float32)


def _in_steps(sh: np.ndarray, steps: np.ndarray) -> np.ndarray:
    """128 times SH, rounded to multiples of the steps, from -128 to 127."""
    values = sh * (128 / steps)
    np.rint(values, out=values)
    values *= steps
    return np.clip(values, -128, 127, out=values)


def _colors(sh: np.ndarray) -> np.ndarray:
    """8 bits of SH of degree 0 (N, 3)."""
    return to_uint8(sh * np.float32(COLOR * 255) + np.float32(127.5))


def _sh_of_colors(stored: np.ndarray) -> np.ndarray:
    return (stored.astype(np.float32) / 255 - np.float32(0.5)) / np.float32(COLOR)


def _rounded(scene: Scene, steps: np.ndarray, seen: SeenFrom) -> np.ndarray:
    """SH (N, K, 3) in values that the file holds, those with the least error where they are seen from."""

    def stored(k: int, values: np.ndarray) -> np.ndarray:
        if k == 0:
            return _sh_of_colors(_colors(values))
        return _in_steps(values, steps[:, None]) / 128

    return rounded(scene.sh, seen.moments(scene.means, scene.sh.shape[1]), stored)


FORMAT = SplatFormat(
    name="spz",
    label="SPZ",
    suffixes=(".spz",),
    sniff=lambda head: head.startswith((MAGIC, GZIP)),
    read_parts=read_parts,
    write=write,
    versions=(4, 3, 2),
    quantises=True,
    limits=limits,
    carries=("antialiased",),
    needs=zstd.lack,
)
