"""Both Adam moments of the values in one array, as the native library keeps them (native/include/svrgs.h, svrgs_adam).

float32 values have uint32 words, m in 20 bits and v in 12, so that they take no more memory than what they belong to; float64
values, which are for comparison, have complex128, m + i v. SH coefficients (N, K, 3) share one v a Gaussian, that of degree 0: a row
holds m of each, float32 in 16 bits, and then v. The mean of the squared basis over all directions is the same for every coefficient.
"""

from __future__ import annotations

import numpy as np

from ..native import moments_like


def none_yet(values: np.ndarray) -> np.ndarray:
    """The moments of float32 or float64 values before the first step, all zero."""
    return np.zeros(*moments_like(values.shape, values.dtype))


def unpacked(moments: np.ndarray, shape: tuple) -> tuple[np.ndarray, np.ndarray]:
    """First and second moments m, v of values of that shape, as real as these: both of it, but v (N,) of SH coefficients."""
    if len(shape) == 3:
        return _unpacked_shared(moments, shape)
    if moments.dtype == np.complex128:
        return moments.real.copy(), moments.imag.copy()
    return (moments & np.uint32(0xFFFFF000)).view(np.float32), (moments << np.uint32(20) >> np.uint32(1)).view(np.float32)


def packed(m: np.ndarray, v: np.ndarray, step: int) -> np.ndarray:
    """What the library stores of moments m, v, as from unpacked(), after the step of that number."""
    if m.ndim == 3:
        return _packed_shared(m, v, step)
    if m.dtype == np.float64:
        pairs = np.empty(m.shape, np.complex128)
        pairs.real, pairs.imag = m, v
        return pairs
    first = _leading_bits(m)
    return first | v.view(np.uint32) + (_noise(first, step) >> np.uint32(13)) >> np.uint32(19)


def _unpacked_shared(moments: np.ndarray, shape: tuple) -> tuple[np.ndarray, np.ndarray]:
    if moments.dtype == np.float64:
        return moments[:, :-1].reshape(shape).copy(), moments[:, -1].copy()
    halves = moments[:, :-1].copy().view(np.uint16)[:, : shape[1] * shape[2]]
    return (halves.astype(np.uint32) << np.uint32(16)).view(np.float32).reshape(shape), moments[:, -1].view(np.float32).copy()


def _packed_shared(m: np.ndarray, v: np.ndarray, step: int) -> np.ndarray:
    rows, first = np.zeros(*moments_like(m.shape, m.dtype)), m.reshape(len(m), -1)
    if m.dtype == np.float64:
        rows[:, :-1], rows[:, -1] = first, v
        return rows
    noise = _noise(_leading_bits(first), step) >> np.uint32(16)
    rows.view(np.uint16)[:, : first.shape[1]] = first.view(np.uint32) + noise >> np.uint32(16)
    rows[:, -1] = v.view(np.uint32)
    return rows


def _leading_bits(m: np.ndarray) -> np.ndarray:
    """The upper 20 of float32 values, rounded to nearest."""
    return m.view(np.uint32) + np.uint32(0x800) & np.uint32(0xFFFFF000)


def _noise(bits: np.ndarray, step: int) -> np.ndarray:
    """Random bits, to be added before others are cut off: so a value is rounded up as often as it is near to that."""
    x = bits ^ np.uint32(step * 0x9E3779B1 & 0xFFFFFFFF)
    return (x ^ x >> np.uint32(15)) * np.uint32(0x85EBCA6B)
