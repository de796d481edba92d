"""Both Adam moments of every value in one array, as the native library keeps them (native/include/svrgs.h, svrgs_adam):
float32 values have uint32 words, m in 20 bits and v in 12, so that they take no more memory than what they belong to;
float64 values, which are for comparison, have complex128, m + i v."""

from __future__ import annotations

import numpy as np

from ..native import MOMENT_TYPES


def none_yet(values: np.ndarray) -> np.ndarray:
    """The moments of float32 or float64 values before the first step, all zero."""
    return np.zeros(values.shape, MOMENT_TYPES[values.dtype])


def unpacked(moments: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """First and second moments m, v, as real as the values."""
    if moments.dtype == np.complex128:
        return moments.real.copy(), moments.imag.copy()
    return (moments & np.uint32(0xFFFFF000)).view(np.float32), (moments << np.uint32(20) >> np.uint32(1)).view(np.float32)


def packed(m: np.ndarray, v: np.ndarray, step: int) -> np.ndarray:
    """What the library stores of moments m, v after the step of that number."""
    if m.dtype == np.float64:
        pairs = np.empty(m.shape, np.complex128)
        pairs.real, pairs.imag = m, v
        return pairs
    first = m.view(np.uint32) + np.uint32(0x800) & np.uint32(0xFFFFF000)
    x = first ^ np.uint32(step * 0x9E3779B1 & 0xFFFFFFFF)
    noise = (x ^ x >> np.uint32(15)) * np.uint32(0x85EBCA6B) >> np.uint32(13)
    return first | v.view(np.uint32) + noise >> np.uint32(19)
