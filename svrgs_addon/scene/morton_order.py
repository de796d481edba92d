"""Morton order of Gaussians (Z-order curve).

A run keeps its Gaussians in memory in this order. Gaussians that are close in space, and so are seen by the
same views, are then close in memory, and a view reads fewer cache lines. Files keep their own order.
"""

from __future__ import annotations

import numpy as np

BITS = 21  # per axis; three axes fill the 63 bits of a non-negative int64
# means between them define centre and extent, so that outliers have no influence
CENTRAL_PERCENTILES = (25, 75)
BOX_HALF_SIDE = 32  # in extents; means outside the box are clamped to its sides
BLOCK = 1 << 16  # means whose codes are found together; the arrays of one block stay in the cache

# (shift, mask) of each step: it halves groups of adjacent bits, until two zeros separate any two bits
_SPREAD = (
    (32, 0x1F00000000FFFF),
    (16, 0x1F0000FF0000FF),
    (8, 0x100F00F00F00F00F),
    (4, 0x10C30C30C30C30C3),
    (2, 0x1249249249249249),
)


def morton_order(means: np.ndarray) -> np.ndarray:
    """Rows of means (N, 3) along the Morton curve, (N,) int64. Rows with equal codes keep their order."""
    return np.argsort(morton_codes(means), kind="stable")


def morton_codes(means: np.ndarray) -> np.ndarray:
    """Morton code of each mean (N, 3), (N,) int64: its position on the curve through a box of 2^21 cells per
    side, whose centre and size are from central_box(). NaN is clamped to the low side of the box."""
    centre, extent = central_box(means)
    codes = np.empty(len(means), np.int64)
    for start in range(0, len(means), BLOCK):
        codes[start : start + BLOCK] = _codes(means[start : start + BLOCK], centre, extent)
    return codes


def _codes(means: np.ndarray, centre: np.ndarray, extent: float) -> np.ndarray:
    """Codes of some means in the box of all."""
    half = 1 << (BITS - 1)
    codes = np.zeros(len(means), np.int64)
    for axis in range(3):
        with np.errstate(over="ignore"):  # infinite cells are clamped like others
            cells = (means[:, axis] - centre[axis]) * (half / (BOX_HALF_SIDE * extent)) + half
        codes |= spread_bits(np.fmin(np.fmax(cells, 0), 2 * half - 1).astype(np.int64)) << axis
    return codes


def central_box(means: np.ndarray) -> tuple[np.ndarray, float]:
    """Centre (3,) and longest side of the box between the 25th and 75th percentile of the finite means (N, 3)
    per axis, float64. The side is never 0. Without finite means: (0, 0, 0) and 1."""
    known = np.isfinite(means)
    finite = (means if known.all() else means[known.all(axis=1)]).astype(np.float64)
    if not len(finite):
        return np.zeros(3), 1.0
    low, high = np.percentile(finite, CENTRAL_PERCENTILES, axis=0)
    return (low + high) / 2, float((high - low).max() or np.ptp(finite, axis=0).max() or 1.0)


def spread_bits(cells: np.ndarray) -> np.ndarray:
    """Moves bit k of each int64 to bit 3 k, for k < 21."""
    for shift, mask in _SPREAD:
        cells = (cells | cells << shift) & mask
    return cells
