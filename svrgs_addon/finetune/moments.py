"""The Adam moments m and v in the layout of the native library (native/include/svrgs.h, svrgs_adam).

Of a float32 value, one 32-bit word holds both moments. So they need no more memory than the value itself:

    bits       31          30 - 23          22 - 12                    11 - 4          3 - 0
    holds      sign of m   exponent of m    mantissa of m, 11 bits     exponent of v   mantissa of v, 4 bits
    rounding   m: to nearest                                           v: stochastic

v is never negative and needs no sign. One step changes v by about 0.1 %, while the last stored bit of v is 3
to 6 % of v. So v needs stochastic rounding: a random number of 19 bits is added before the last 19 bits are
cut off, and the stored value is right on average.

SH coefficients (N, K, 3) have one m each and one v per Gaussian:

    part of a row        holds                                                       rounding
    3 K times 16 bits    m: sign, 8 bits of exponent, 7 bits of mantissa             stochastic
    (0 or 16 bits)       padding to a multiple of 32 bits
    32 bits              v of the mean square of the three gradients of degree 0     none

One v is enough because the mean of the squared basis over all directions is the same for every coefficient
(docs/methods.md, "Adam").

float64 values are for comparison and are not rounded: m + i v as complex128; of SH coefficients, m of each
and then v as float64.
"""

from __future__ import annotations

import numpy as np

from ..native.rasterizer import moments_like


def zero_moments(values: np.ndarray) -> np.ndarray:
    """The moments of `values` (float32 or float64) before the first step: all 0."""
    return np.zeros(*moments_like(values.shape, values.dtype))


def unpacked(moments: np.ndarray, shape: tuple) -> tuple[np.ndarray, np.ndarray]:
    """The moments m and v as floats of the values' dtype. shape: that of the values; m has it, and v too, but
    v of SH coefficients is (N,)."""
    if len(shape) == 3:
        return _unpacked_shared(moments, shape)
    if moments.dtype == np.complex128:
        return moments.real.copy(), moments.imag.copy()
    v = moments << np.uint32(20) >> np.uint32(1)
    return (moments & np.uint32(0xFFFFF000)).view(np.float32), v.view(np.float32)


def packed(m: np.ndarray, v: np.ndarray, step: int) -> np.ndarray:
    """The inverse of unpacked(): the layout that the library stores after step number `step`, which seeds the
    stochastic rounding."""
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
    m = (halves.astype(np.uint32) << np.uint32(16)).view(np.float32).reshape(shape)
    return m, moments[:, -1].view(np.float32).copy()


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
    """The upper 20 bits of float32 values, rounded to nearest; the lower 12 bits are 0."""
    return m.view(np.uint32) + np.uint32(0x800) & np.uint32(0xFFFFF000)


def _noise(bits: np.ndarray, step: int) -> np.ndarray:
    """32 random bits per value for stochastic rounding, from the leading bits of m and the step."""
    x = bits ^ np.uint32(step * 0x9E3779B1 & 0xFFFFFFFF)
    return (x ^ x >> np.uint32(15)) * np.uint32(0x85EBCA6B)
