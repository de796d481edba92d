"""Estimates of the memory that a job needs, and the memory that is available.

A job whose estimate exceeds the available memory is refused before it starts; the message names both numbers.
What the system says is read in system/memory_limits.py.

Estimates are in bytes. count: Gaussians. coefficients: SH coefficients per channel, K. cameras: all views, of
which the largest one counts. kept_photographs: memory budget of cached photographs in bytes; at most 3 bytes
per pixel of all views are counted. averaged: Gaussians that are left when values are averaged; 0 if none are.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Protocol

from .errors import MemoryShort, SceneError
from .memory_limits import address_limit, available


class View(Protocol):
    """Anything of a size in pixels: a Camera. Importing that, and with it NumPy, needs memory."""

    @property
    def width(self) -> int: ...
    @property
    def height(self) -> int: ...


# Measured as the growth of the process in bytes (docs/reliability.md).
READING = 1.3  # bytes per byte of a splat file: its arrays, and copies of some of them during repair
# 4-byte values per Gaussian without SH: mean 3, log-scale 3, quaternion 4, two logits, source row
ROW_FLOATS = 13
# bytes of Adam moments per SH coefficient; other values have moments of their own size, 4 bytes
SH_MOMENT = 2
STATISTICS = 8  # bytes per Gaussian: the statistics of densification
ADDED_COPIES = 2  # temporary copies of the values of a Gaussian that densification adds
PROJECTED = 150  # bytes per projected Gaussian
STREAMED = 65  # bytes per Gaussian of a compressed file that is unpacked, without SH; an SPZ needs most
TEXTURED = 150  # bytes per Gaussian that becomes pixels of a SOG
RANKED = 400  # bytes per Gaussian while its rank is measured, without its values in float64
DECIMATED = 500  # bytes per Gaussian while it is removed or merged, without its values
RENDERED_PIXEL = 50  # bytes per pixel of a view: a picture
KEPT_PIXEL = 50  # the same, for what gradients or statistics need in addition
TUNED_PIXEL, MEASURED_PIXEL = 200, 100  # the same: fine-tuning, metrics
LPIPS_PIXEL = 1000  # bytes per pixel of a view: LPIPS
COMPARED_PIXEL = 60  # bytes per pixel of each view of which two scenes are shown in a report
# bytes of addresses needed by NumPy; by pycolmap, OpenImageIO and SciPy too, and by the threads that read
NUMPY_ADDRESSES, PHOTOGRAPH_ADDRESSES = 200_000_000, 1_000_000_000


def reading(file_bytes: int) -> int:
    """Bytes to read a splat file of file_bytes bytes."""
    return int(READING * file_bytes)


def unpacking(count: int, coefficients: int) -> int:
    """Bytes to read Gaussians out of a compressed file: in parts, which are then joined."""
    return 2 * 4 * (11 + 3 * coefficients) * count


def unpacking_in_parts(count: int, coefficients: int) -> int:
    """Bytes to read a compressed file in parts: of it, and of streams or textures unpacked as a whole."""
    return (STREAMED + 6 * coefficients) * count


def texturing(count: int, coefficients: int) -> int:
    """Bytes to turn Gaussians that are in memory already into textures and a palette."""
    return (TEXTURED + 4 * 3 * coefficients) * count


def rendering(count: int, width: int, height: int) -> int:
    """Bytes to render one view, width x height pixels, of Gaussians that are in memory already."""
    return PROJECTED * count + RENDERED_PIXEL * width * height


def tuning(
    count: int, coefficients: int, cameras: Sequence[View], kept_photographs: int, averaged: int = 0
) -> int:
    """Bytes to fine-tune and evaluate Gaussians."""
    row, moments = _trained_row(coefficients)
    # the first steps, the averaged ones; the memory of removed rows is not freed
    besides = max(PROJECTED * count, (PROJECTED + row) * averaged)
    return int(
        (row + moments) * count
        + besides
        + (TUNED_PIXEL + MEASURED_PIXEL) * _largest(cameras)
        + _kept(cameras, kept_photographs)
    )


def decimating(count: int, coefficients: int, cameras: Sequence[View]) -> int:
    """Bytes to remove and merge (finetune/decimate/) and to fine-tune what is left, on kept pictures."""
    work = max(ordering(count, coefficients, cameras), tuning(count, coefficients, cameras, 0))
    return work + 12 * sum(_pixels(cameras))


def ordering(count: int, coefficients: int, cameras: Sequence[View]) -> int:
    """Bytes to order removals and merges."""
    pixels = (RENDERED_PIXEL + KEPT_PIXEL) * _largest(cameras)
    return (DECIMATED + _trained_row(coefficients)[0]) * count + pixels


def ranking(count: int, coefficients: int) -> int:
    """Bytes to measure how sure ranks are, besides rendering: the parameters as float64, and statistics."""
    return (RANKED + 8 * (11 + 3 * coefficients)) * count


def measuring(count: int, cameras: Sequence[View], kept_photographs: int, lpips: bool) -> int:
    """Bytes to evaluate Gaussians that are in memory already. lpips: whether LPIPS is measured too."""
    pixels = (RENDERED_PIXEL + MEASURED_PIXEL) * _largest(cameras) + perceiving(cameras, lpips)
    return PROJECTED * count + pixels + _kept(cameras, kept_photographs)


def perceiving(cameras: Sequence[View], lpips: bool = True) -> int:
    """Bytes that LPIPS needs in addition, if it is measured."""
    return LPIPS_PIXEL * _largest(cameras) if lpips else 0


def comparing(
    count: int, cameras: Sequence[View], shown: Sequence[View], kept_photographs: int, lpips: bool
) -> int:
    """Bytes to compare two scenes in memory, the larger one of `count`. shown: views with pictures."""
    return measuring(count, cameras, kept_photographs, lpips) + COMPARED_PIXEL * sum(_pixels(shown))


def growing(count: int, added: int, coefficients: int, cameras: Sequence[View]) -> int:
    """Bytes that adding `added` Gaussians in training needs in addition. The arrays are copied one after the
    other, so one copy of the largest counts. Metrics of a view at the end must fit as well."""
    (row, moments), largest = _trained_row(coefficients), 4 * 3 * coefficients
    new = (1 + ADDED_COPIES) * row + moments + PROJECTED
    return new * added + largest * (count + added) + MEASURED_PIXEL * _largest(cameras)


def checkpoint(count: int, coefficients: int, averaged: int = 0) -> int:
    """Bytes on disk of the largest checkpoint of a run that has `count` Gaussians now."""
    row, moments = _trained_row(coefficients)
    return max((row + moments + STATISTICS) * count, (2 * row + moments + STATISTICS) * averaged)


def _trained_row(coefficients: int) -> tuple[int, int]:
    """Bytes of the parameters and of the Adam moments of one Gaussian with K SH coefficients per channel."""
    other = 4 * ROW_FLOATS
    return other + 4 * 3 * coefficients, other + SH_MOMENT * 3 * coefficients


# advice
BY_BLOCKS = "svrgs large prunes it by blocks, with less"
IN_PARTS = "svrgs convert and svrgs large read it in parts"


def without_advice(sentence: str) -> str:
    """The sentence of an error without BY_BLOCKS or IN_PARTS at its end: for work that goes on so."""
    return sentence.removesuffix(f"; {BY_BLOCKS}").removesuffix(f"; {IN_PARTS}")


def shortage(what: str, needed: int) -> str:
    """A sentence if `needed` bytes exceed the available memory, else ''. what: 'pruning a.ply'."""
    free = available()
    if free is None or needed <= free:
        return ""
    return f"{what} needs about {size_text(needed)} of memory, but only {size_text(free)} are available"


def refuse_excess(what: str, needed: int, advice: str = "") -> None:
    """Raises MemoryShort with the sentence of shortage() if there is one. advice: what else can be done."""
    if sentence := shortage(what, needed):
        raise MemoryShort(f"{sentence}; {advice}" if advice else sentence)


def refuse_few_addresses(least: int) -> None:
    """Raises SceneError if the process may have less than `least` bytes of addresses (ulimit -v).

    Call it before NumPy and pycolmap are imported: with too few, they fail in ways that a program cannot
    catch, or never return.
    """
    limit = address_limit()
    if limit is not None and limit < least:
        raise SceneError(
            f"this process may use only {size_text(limit)} of memory (ulimit -v), but needs at least"
            f" {size_text(least)}; raise the limit"
        )


def _kept(cameras: Sequence[View], budget: int) -> int:
    """Bytes of cached photographs of 8 bits per channel within the budget."""
    return min(budget, 3 * sum(_pixels(cameras)))


def _pixels(cameras: Sequence[View]) -> list[int]:
    """Number of pixels of each view."""
    return [camera.width * camera.height for camera in cameras]


def _largest(cameras: Sequence[View]) -> int:
    """Number of pixels of the largest view."""
    return max(_pixels(cameras), default=0)


def size_text(value: float) -> str:
    """Bytes as text: '1.2 GB', '150.0 MB', '12 bytes'."""
    for limit, unit in ((1e9, "GB"), (1e6, "MB"), (1e3, "kB")):
        if value >= limit:
            return f"{value / limit:.1f} {unit}"
    return f"{value:.0f} bytes"


def part_text(part: int, whole: int) -> str:
    """Two numbers of bytes, the first below the second, as text: '0.1 of 21.7 MB', or '12 bytes of 21.7 MB
    are missing'."""
    number, unit = size_text(whole).split()
    shown = f"{part * float(number) / whole:.1f}" if unit != "bytes" else str(part)
    if shown != number:
        return f"{shown} of {number} {unit}"
    return f"{size_text(whole - part)} of {number} {unit} are missing"
