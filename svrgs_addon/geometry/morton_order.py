"""Where Gaussians lie in memory: along a Morton curve, so that what a view sees lies together."""

from __future__ import annotations

import numpy as np

BITS = 21  # an axis: three of them fill an int64
MIDDLE = (25, 75)  # percent: between them lies what the scene is about, whatever lies around it
REACH = 32  # extents from the centre to the sides of the box; what is further out counts as lying on them

# (shift, mask): each doubles the number of groups the bits stand in, until there are two free places between any two.
_SPREAD = ((32, 0x1F00000000FFFF), (16, 0x1F0000FF0000FF), (8, 0x100F00F00F00F00F), (4, 0x10C30C30C30C30C3), (2, 0x1249249249249249))


def morton_order(means: np.ndarray) -> np.ndarray:
    """(N,) int64: the rows of means (N, 3) as a Morton curve meets them, equals in their present order."""
    return np.argsort(morton_codes(means), kind="stable")


def morton_codes(means: np.ndarray) -> np.ndarray:
    """(N,) int64: each mean's place on the curve through a box of 2^21 cells a side; NaN counts as the low side of the box."""
    centre, extent = middle(means)
    half = 1 << (BITS - 1)
    codes = np.zeros(len(means), np.int64)
    for axis in range(3):
        cells = (means[:, axis] - centre[axis]) * (half / (REACH * extent)) + half
        codes |= spread(np.fmin(np.fmax(cells, 0), 2 * half - 1).astype(np.int64)) << axis
    return codes


def middle(means: np.ndarray) -> tuple[np.ndarray, float]:
    """Centre (3,) and largest side of the box that holds the middle half of the finite means along each axis, float64; the side is never 0."""
    finite = means[np.isfinite(means).all(axis=1)].astype(np.float64)
    if not len(finite):
        return np.zeros(3), 1.0
    low, high = np.percentile(finite, MIDDLE, axis=0)
    return (low + high) / 2, float((high - low).max() or np.ptp(finite, axis=0).max() or 1.0)


def spread(cells: np.ndarray) -> np.ndarray:
    """Bit k of each int64 moved to bit 3 k."""
    for shift, mask in _SPREAD:
        cells = (cells | cells << shift) & mask
    return cells
