"""Fewer or more Gaussians than a job kept, chosen by its scores (ranking.py): kept and removed Gaussians in
one scene."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from ..files.sh_rounding import without_bands
from ..scene.gaussians import PARAMETERS, Scene

BOUNDARY = 0.5  # Gaussians with a score above were kept by the job
MANY_POINTS = 10_000  # by which a motion is found, about
CLEARLY = 0.25  # of the distance that another motion leaves: then a fitted one is taken


def lowest(score: np.ndarray, count: int) -> float:
    """The lowest of the `count` highest scores; -inf if count >= N, inf if count < 1. score (N,)."""
    if count >= len(score):
        return -np.inf
    return np.inf if count < 1 else float(np.partition(score, len(score) - count)[len(score) - count])


def numbered(count: int) -> np.ndarray:
    """The row numbers 0 to count - 1, int32."""
    return np.arange(count, dtype=np.int32)


def place_of(
    before: np.ndarray, rows_before: np.ndarray, after: np.ndarray, rows: np.ndarray, moved: np.ndarray
) -> np.ndarray:
    """(4, 4) from the coordinates of a splat to those of the one that a job made of it: the identity,
    wherever the objects stand; `moved` (4, 4), which is between the objects, if transforms were applied to
    one of them; or, if that one was moved before, the affine map that fits best.

    before, after: (N, 3) and (n, 3) means. rows_before, rows: their source rows, of which some are the same.
    """
    _, both, kept = np.intersect1d(rows_before, rows, return_indices=True)
    finite = np.isfinite(before[both]).all(axis=1) & np.isfinite(after[kept]).all(axis=1)
    some = np.flatnonzero(finite)[:: max(1, int(finite.sum()) // MANY_POINTS)]
    if not len(some):
        return moved
    here, there = before[both[some]].astype(np.float64), after[kept[some]].astype(np.float64)
    here = np.column_stack([here, np.ones(len(some))])
    apart = lambda place, share: np.quantile(np.linalg.norm(here @ place[:3].T - there, axis=1), share)
    found = min((np.eye(4), moved), key=lambda place: apart(place, 0.5))
    fitted = np.vstack([np.linalg.lstsq(here, there, rcond=None)[0].T, (0, 0, 0, 1)])
    solid = np.linalg.matrix_rank(here) == 4
    return fitted if solid and apart(fitted, 0.95) < CLEARLY * apart(found, 0.5) else found


def among(rows: np.ndarray, others: np.ndarray) -> np.ndarray:
    """(N,) bool: which of the source rows (N,) are among others."""
    return np.isin(rows, others)


def in_order(rows: np.ndarray, values: np.ndarray, other_rows: np.ndarray, others: np.ndarray) -> np.ndarray:
    """The values of two parts in the order of their source rows, as merged() has the Gaussians."""
    return np.concatenate([values, others])[np.argsort(np.concatenate([rows, other_rows]), kind="stable")]


def merged(a: Scene, rows_a: np.ndarray, b: Scene, rows_b: np.ndarray) -> Scene:
    """One scene with the Gaussians of both, in the order of their source rows, with the SH bands of a. Of
    further columns, those that both have.

    rows_a, rows_b: the source row of each Gaussian.
    """
    b = without_bands(b, a.sh_degree)
    join = lambda name: np.concatenate([getattr(a, name), getattr(b, name)])
    attributes = {
        name: np.concatenate([column, b.attributes[name]])
        for name, column in a.attributes.items()
        if name in b.attributes
    }
    whole = replace(a, **{name: join(name) for name in PARAMETERS}, attributes=attributes)
    return whole.select(np.argsort(np.concatenate([rows_a, rows_b]), kind="stable"))
