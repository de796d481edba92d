"""Functions that all metrics use: the check of two images, their tiles, and separable filters."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from typing import Literal, TypeVar

import numpy as np

from ..errors import SceneError
from ..native_library import threads

TILE = 256  # side of a tile, pixels

T = TypeVar("T")
Window = tuple[slice, slice]  # rows and columns


def image_pair(a: np.ndarray, b: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Both images as contiguous float32 (H, W, 3). Raises SceneError if their shapes differ or a value is not finite."""
    a, b = np.ascontiguousarray(a, np.float32), np.ascontiguousarray(b, np.float32)
    if a.shape != b.shape or a.ndim != 3 or a.shape[2] != 3 or a.size == 0:
        raise SceneError(f"cannot compare images of shapes {a.shape} and {b.shape}; both must be (H, W, 3)")
    if not (np.isfinite(a).all() and np.isfinite(b).all()):
        raise SceneError("cannot compare images that hold NaN or infinite values")
    return a, b


def over_tiles(work: Callable[[Window, Window], T], shape: tuple[int, ...], margin: int) -> list[T]:
    """Calls work(outer, inner) for each tile of an image (H, W, ...), row by row, and returns the results in this order.

    A metric that works on tiles needs little memory, its arrays fit into the cache, and the threads of the native library share the
    tiles. outer: rows and columns of the tile and of `margin` pixels around it, as far as the image has them. inner: the tile within
    the outer rows and columns. Filters with a radius of at most `margin` are right on the inner pixels.
    """
    with ThreadPoolExecutor(threads()) as pool:
        return list(pool.map(lambda tile: work(*tile), _tiles(shape[0], shape[1], margin)))


def _tiles(height: int, width: int, margin: int) -> Iterator[tuple[Window, Window]]:
    for y in range(0, height, TILE):
        for x in range(0, width, TILE):
            top, left = max(0, y - margin), max(0, x - margin)
            bottom, right = min(height, y + TILE), min(width, x + TILE)
            outer = slice(top, bottom + margin), slice(left, right + margin)
            yield outer, (slice(y - top, bottom - top), slice(x - left, right - left))


def filter_axis(planes: np.ndarray, taps: np.ndarray, axis: int, mode: Literal["edge", "constant"]) -> np.ndarray:
    """Correlates `planes` with an odd number of taps along one axis. Shape and dtype stay the same.

    mode: padding at the border, as in numpy.pad ('edge', 'constant').
    """
    radius = len(taps) // 2
    widths = [(radius, radius) if i == axis % planes.ndim else (0, 0) for i in range(planes.ndim)]
    padded = np.moveaxis(np.pad(planes, widths, mode), axis, 0)
    size = planes.shape[axis]
    total = padded[:size] * taps.dtype.type(0)
    term = np.empty_like(total)
    for k, tap in enumerate(taps):
        np.multiply(padded[k : k + size], tap, out=term)
        total += term
    return np.moveaxis(total, 0, axis)


def filter_separable(planes: np.ndarray, taps_y: np.ndarray, taps_x: np.ndarray, mode: Literal["edge", "constant"]) -> np.ndarray:
    """Correlates the last two axes (y, x) of `planes` with the outer product of two filters of odd length. The shape stays the same."""
    taps_y, taps_x = taps_y.astype(planes.dtype), taps_x.astype(planes.dtype)
    return filter_axis(filter_axis(planes, taps_y, -2, mode), taps_x, -1, mode)
