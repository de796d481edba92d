"""The nearest points of a point cloud and their distances, exact, with NumPy alone.

The points are split at medians into leaves of up to LEAF points. The points of a leaf are compared with those
of all leaves that are near enough. A tree of groups of leaves keeps the search for these short.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

LEAF = 32  # points, or more where many neighbours are wanted
GROUP = 64  # leaves that are tested together
FIRST = 16  # leaves that are searched first where there are many


def nearest_distances(points: np.ndarray, count: int) -> np.ndarray:
    """Distances (P, count) float64, ascending, to the nearest other points (P, 3), finite, P > count."""
    result = np.empty((len(points), count))
    for own, squares, places, _ in _searches(points, count):
        result[own] = np.sqrt(_smallest(squares, count, places))
    return result


def nearest_rows(points: np.ndarray, count: int) -> np.ndarray:
    """Rows (P, count) int64, in no order, of the nearest other points (P, 3), finite, P > count."""
    result = np.empty((len(points), count), np.int64)
    for own, squares, places, others in _searches(points, count):
        squares[np.arange(len(own)), places] = np.inf
        result[own] = others[np.argpartition(squares, count - 1, axis=1)[:, :count]]
    return result


def _searches(
    points: np.ndarray, count: int
) -> Iterator[tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]]:
    """For each leaf: rows (A,) of its points; squared distances (A, B) to points among which the `count`
    nearest others are; the columns (A,) of the leaf's own points; rows (B,) of the columns."""
    points = np.asarray(points, np.float64)
    order, starts = _leaves(points, max(LEAF, 2 * (count + 1)))
    sorted_points = points[order]
    low, high = (ufunc.reduceat(sorted_points, starts[:-1], axis=0) for ufunc in (np.minimum, np.maximum))
    groups = np.arange(0, len(low), GROUP)
    low_of_groups = np.minimum.reduceat(low, groups, axis=0)
    high_of_groups = np.maximum.reduceat(high, groups, axis=0)
    for leaf in range(len(low)):
        rows = slice(starts[leaf], starts[leaf + 1])
        own = sorted_points[rows]
        reach = _reach(own, own, count, np.arange(len(own)))
        near = np.flatnonzero(_gaps(low[leaf], high[leaf], low_of_groups, high_of_groups) <= reach.max())
        leaves = (near[:, None] * GROUP + np.arange(GROUP)).ravel()
        leaves = leaves[leaves < len(low)]
        gaps = _gaps(low[leaf], high[leaf], low[leaves], high[leaves])
        leaves, gaps = leaves[gaps <= reach.max()], gaps[gaps <= reach.max()]
        if len(leaves) > 2 * FIRST:  # the nearest of them bring the reach down
            first = _rows(starts, np.union1d(leaves[np.argpartition(gaps, FIRST)[:FIRST]], leaf))
            reach = _reach(
                own, sorted_points[first], count, np.searchsorted(first, np.arange(rows.start, rows.stop))
            )
            leaves = leaves[gaps <= reach.max()]
            leaves = leaves[_any_within(own, low[leaves], high[leaves], reach)]
        others = _rows(starts, leaves)
        yield (
            order[rows],
            _squares(own, sorted_points[others]),
            np.searchsorted(others, np.arange(rows.start, rows.stop)),
            order[others],
        )


def _leaves(points: np.ndarray, size: int) -> tuple[np.ndarray, np.ndarray]:
    """The rows of the points, leaf after leaf of up to `size` points, and where the leaves begin (one more:
    the number of points)."""
    stack, parts = [np.arange(len(points))], []
    while stack:
        rows = stack.pop()
        if len(rows) <= size:
            parts.append(rows)
            continue
        axis = int(np.argmax(np.ptp(points[rows], axis=0)))
        middle = len(rows) // 2
        split = rows[np.argpartition(points[rows, axis], middle)]
        stack += [split[middle:], split[:middle]]
    return np.concatenate(parts), np.cumsum([0, *map(len, parts)])


def _rows(starts: np.ndarray, leaves: np.ndarray) -> np.ndarray:
    """The rows of all points of the leaves, which are in ascending order."""
    return np.concatenate([np.arange(starts[leaf], starts[leaf + 1]) for leaf in leaves])


def _reach(own: np.ndarray, others: np.ndarray, count: int, places: np.ndarray) -> np.ndarray:
    """Squared distances (A,) of points to their `count`-th nearest of the others, of which `places` (A,) are
    these points; inf with too few."""
    if len(others) > count:
        return _smallest(_squares(own, others), count, places)[:, -1]
    return np.full(len(own), np.inf)


def _any_within(points: np.ndarray, lows: np.ndarray, highs: np.ndarray, reach: np.ndarray) -> np.ndarray:
    """(B,) bool: boxes with corners (B, 3) within the squared distances reach (A,) of points (A, 3)."""
    gap = np.maximum(np.maximum(lows - points[:, None], points[:, None] - highs), 0)
    return ((gap**2).sum(axis=2) <= reach[:, None]).any(axis=0)


def _gaps(low: np.ndarray, high: np.ndarray, lows: np.ndarray, highs: np.ndarray) -> np.ndarray:
    """Squared distances (B,) between a box and boxes, given by their corners (3,) and (B, 3)."""
    gap = np.maximum(np.maximum(lows - high, low - highs), 0)
    return (gap**2).sum(axis=1)


def _squares(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """Squared distances (A, B) between points (A, 3) and (B, 3)."""
    dx, dy, dz = (a[:, None, axis] - b[None, :, axis] for axis in range(3))
    return dx * dx + dy * dy + dz * dz


def _smallest(squares: np.ndarray, count: int, own: np.ndarray) -> np.ndarray:
    """The `count` smallest values of each row (A, B), ascending, without that in the column own (A,)."""
    squares[np.arange(len(own)), own] = np.inf
    return np.sort(np.partition(squares, count - 1, axis=1)[:, :count], axis=1)
