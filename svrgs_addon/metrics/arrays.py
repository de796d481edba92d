"""Functions that all metrics use: the check of two images, and separable filters."""

from __future__ import annotations

from typing import Literal

import numpy as np

from ..errors import SceneError


def image_pair(a: np.ndarray, b: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Both images as float32 (H, W, 3). Raises SceneError if their shapes differ or a value is not finite."""
    a, b = np.asarray(a, np.float32), np.asarray(b, np.float32)
    if a.shape != b.shape or a.ndim != 3 or a.shape[2] != 3 or a.size == 0:
        raise SceneError(f"cannot compare images of shapes {a.shape} and {b.shape}; both must be (H, W, 3)")
    if not (np.isfinite(a).all() and np.isfinite(b).all()):
        raise SceneError("cannot compare images that hold NaN or infinite values")
    return a, b


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
