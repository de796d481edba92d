"""Lets shapes and colours of Gaussians follow points that were moved together: by a rotation, a scaling, or
another affine map.

Blender's Apply and Join move the points of a splat and leave its other attributes as they were. From the
positions before and after, the matrix of each group of points is found again, and affine.py transforms the
Gaussians with it.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

import numpy as np

from .affine import transformed
from .gaussians import Scene

TOLERANCE = 1e-5  # of a point's coordinates, for what float32 rounds
MAX_GROUPS = 64
SAMPLE, TRIES = 2000, 40  # points in which a group is searched, and guesses of each kind
MIN_POINTS = {"similarity": 4, "affine": 8}  # of a group: more equations than unknowns
MIN_SHARE = 0.004  # of a group, of the points that were moved
BLOCK = 65_536  # points that are computed at a time


def follow_points(scene: Scene, before: np.ndarray) -> tuple[Scene, int]:
    """The scene with the shapes and view-dependent colours that belong to its means, and the number of
    Gaussians that were transformed. before: (N, 3) float32, the means to which they belong so far."""
    if np.array_equal(before, scene.means):
        return scene, 0
    names, count = ("log_scales", "quats", "sh"), 0
    arrays = {name: getattr(scene, name).copy() for name in names}
    for rows, matrix in moved_parts(before, scene.means):
        part = transformed(scene.select(rows), matrix)
        for name in names:
            arrays[name][rows] = getattr(part, name)
        count += len(rows)
    return (replace(scene, **arrays) if count else scene), count


def moved_parts(before: np.ndarray, after: np.ndarray) -> Iterator[tuple[np.ndarray, np.ndarray]]:
    """Yields (rows, matrix) of each group of points that an affine map other than a translation has moved.

    before, after: (N, 3) float32. rows: (n,) of the group. matrix: (4, 4) float64 with after = matrix ·
    before up to rounding. Points that were moved one by one, and points whose position before is (0, 0, 0) or
    not finite, belong to no group.
    """
    for rows, matrix in _groups(before, after):
        if not _is_translation(matrix, before[rows].astype(np.float64)):
            yield rows, matrix


def common_motion(before: np.ndarray, after: np.ndarray) -> np.ndarray | None:
    """The matrix (4, 4) float64 that moves all points before (N, 3) float32 to after; None: there is none."""
    if np.array_equal(before, after):
        return np.eye(4)
    _, matrix = next(_groups(before, after), (None, None))
    if matrix is not None and _all_moved_by(matrix, before, after, np.arange(len(before))).all():
        return matrix
    return None


def _groups(before: np.ndarray, after: np.ndarray) -> Iterator[tuple[np.ndarray, np.ndarray]]:
    """As moved_parts, with translations."""
    rows = np.flatnonzero((before != after).any(axis=1))
    rows = rows[
        (before[rows] != 0).any(axis=1)
        & np.isfinite(before[rows]).all(axis=1)
        & np.isfinite(after[rows]).all(axis=1)
    ]
    least, rng = MIN_SHARE * len(rows), np.random.default_rng(0)
    for _ in range(MAX_GROUPS):
        if len(rows) < max(least, min(MIN_POINTS.values())):
            break
        some = rows[np.sort(rng.choice(len(rows), min(SAMPLE, len(rows)), replace=False))]
        x, y = before[some].astype(np.float64), after[some].astype(np.float64)
        matrix = _most_common(x, y, rng)
        belongs = _all_moved_by(matrix, before, after, rows) if matrix is not None else np.zeros(1, bool)
        if matrix is None or belongs.sum() < least:
            break
        yield rows[belongs], matrix
        rows = rows[~belongs]
    yield from _runs(before, after, rows)


def _runs(before: np.ndarray, after: np.ndarray, rows: np.ndarray) -> Iterator[tuple[np.ndarray, np.ndarray]]:
    """Groups of rows that follow each other, however many: such as instances that were realised."""
    first, start, failed, size = 0, 0, 0, MIN_POINTS["affine"]
    while start + size <= len(rows) and failed < TRIES:
        end = _end_of_run(before, after, rows, start, start + size)
        some = rows[np.unique(np.linspace(start, end - 1, min(SAMPLE, end - start)).astype(int))]
        x, y = before[some].astype(np.float64), after[some].astype(np.float64)
        matrix, count = _refined(x, y, np.ones(len(some), bool))
        if matrix is None or count < max(size, 0.9 * len(some)):
            failed, start = failed + 1, start + size
            continue
        belongs = _all_moved_by(matrix, before, after, rows[first:end])
        yield rows[first:end][belongs], matrix
        first, start, failed = end, end, 0


def _end_of_run(before: np.ndarray, after: np.ndarray, rows: np.ndarray, start: int, end: int) -> int:
    """The end of the run that begins with rows[start:end]: it is made longer as long as one map moves all."""
    while True:
        further = start + 4 * (end - start)
        some = rows[start:further]
        x, y = before[some].astype(np.float64), after[some].astype(np.float64)
        known, longest = slice(min(end - start, SAMPLE)), 0
        for fit in (_similarity, _affine):
            matrix = fit(x[known], y[known]) if longest < end - start else None
            if matrix is not None:
                moved = _moves(matrix, x, y, 10 * TOLERANCE)
                longest = max(longest, len(moved) if moved.all() else int(moved.argmin()))
        if start + longest < further:
            return max(end, start + longest)
        end = further


def _all_moved_by(matrix: np.ndarray, before: np.ndarray, after: np.ndarray, rows: np.ndarray) -> np.ndarray:
    """Whether the matrix moves these rows, (n,) bool."""
    belongs = np.empty(len(rows), bool)
    for start in range(0, len(rows), BLOCK):
        block = rows[start : start + BLOCK]
        x, y = before[block].astype(np.float64), after[block].astype(np.float64)
        belongs[start : start + BLOCK] = _moves(matrix, x, y, TOLERANCE)
    return belongs


def _most_common(x: np.ndarray, y: np.ndarray, rng: np.random.Generator) -> np.ndarray | None:
    """The matrix (4, 4) that moves most points x (n, 3) to y, as far as is found; None if none does."""
    matrix, count = _refined(x, y, np.ones(len(x), bool))
    if count == len(x):
        return matrix
    best, most = np.zeros(len(x), bool), 0
    for guess in _guesses(len(x), rng):
        for fit in (_similarity, _affine):
            guessed = fit(x[guess], y[guess])
            near = _moves(guessed, x, y, 1e-2) if guessed is not None else best
            if near.sum() > most:
                best, most = near, int(near.sum())
    other, more = _refined(x, y, best)
    return other if more > count else matrix


def _guesses(count: int, rng: np.random.Generator) -> Iterator[np.ndarray]:
    """Rows of small samples: neighbours in the list (joined splats follow each other), or from anywhere."""
    size = min(count, max(MIN_POINTS.values()))
    for _ in range(TRIES):
        yield rng.integers(0, count - size + 1) + np.arange(size)
        yield rng.choice(count, min(size, 4), replace=False)


def _refined(x: np.ndarray, y: np.ndarray, some: np.ndarray) -> tuple[np.ndarray | None, int]:
    """The better of both fits to some points (n,) bool, fitted again to all points that it moves, and their
    number; (None, 0): too few."""
    best: tuple[np.ndarray | None, int] = (None, 0)
    for name, fit in (("similarity", _similarity), ("affine", _affine)):
        belongs = some
        for tolerance in (1e-2, 1e-3, TOLERANCE, TOLERANCE):
            matrix = fit(x[belongs], y[belongs]) if belongs.sum() >= MIN_POINTS[name] else None
            if matrix is None:
                break
            belongs = _moves(matrix, x, y, tolerance)
        else:
            if belongs.sum() > max(1.01 * best[1], MIN_POINTS[name] - 1, MIN_SHARE * len(x)):
                best = matrix, int(belongs.sum())
    return best


def _moves(matrix: np.ndarray, x: np.ndarray, y: np.ndarray, tolerance: float) -> np.ndarray:
    """Whether the matrix moves x (n, 3) to y, (n,) bool. tolerance: relative to what is added."""
    A, t = matrix[:3, :3], matrix[:3, 3]
    size = np.abs(x) @ np.abs(A).T + np.abs(t) + np.abs(y)
    return (np.abs(x @ A.T + t - y) <= tolerance * size.max(axis=1, keepdims=True)).all(axis=1)


def _is_translation(matrix: np.ndarray, x: np.ndarray) -> bool:
    """Whether the matrix only shifts the points x (n, 3), as far as their coordinates can tell."""
    spread = np.abs(x - x.mean(axis=0)).max(axis=0)
    turned = np.abs(matrix[:3, :3] - np.eye(3)) @ spread
    return bool(turned.max() <= 10 * TOLERANCE * max(spread.max(), TOLERANCE * np.abs(x).max()))


def _affine(x: np.ndarray, y: np.ndarray) -> np.ndarray | None:
    """The affine map of least squares, (4, 4); None if the points lie in a plane."""
    if len(x) < 4:
        return None
    centre_x, centre_y = x.mean(axis=0), y.mean(axis=0)
    A, _, rank, sizes = np.linalg.lstsq(x - centre_x, y - centre_y, rcond=None)
    if (
        rank < 3
        or not sizes[2] > 1e-4 * sizes[0]
        or not abs(np.linalg.det(A)) > 1e-9 * np.linalg.norm(A) ** 3
    ):
        return None
    return _matrix(A.T, centre_x, centre_y)


def _similarity(x: np.ndarray, y: np.ndarray) -> np.ndarray | None:
    """Rotation, perhaps mirroring, and scale of least squares (Umeyama 1991), (4, 4); None: undefined."""
    centre_x, centre_y = x.mean(axis=0), y.mean(axis=0)
    variance = ((x - centre_x) ** 2).sum()
    if len(x) < 3 or not variance > 0:
        return None
    U, sizes, Vt = np.linalg.svd((y - centre_y).T @ (x - centre_x))
    if not sizes[1] > 1e-4 * sizes[0]:  # on a line: the rotation about it is unknown
        return None
    flat = sizes[2] <= 1e-6 * sizes[0]  # in a plane: both hands fit, and a rotation is meant
    last = np.sign(np.linalg.det(U @ Vt)) if flat else 1.0
    scale = (sizes * (1, 1, last)).sum() / variance
    return _matrix(scale * (U * (1, 1, last)) @ Vt, centre_x, centre_y)


def _matrix(A: np.ndarray, centre_x: np.ndarray, centre_y: np.ndarray) -> np.ndarray:
    matrix = np.eye(4)
    matrix[:3, :3], matrix[:3, 3] = A, centre_y - A @ centre_x
    return matrix
