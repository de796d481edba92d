"""Fewer or more Gaussians than a job kept, chosen by its scores (ranking.py): kept and removed Gaussians in
one scene."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from ..files.sh_rounding import without_bands
from ..scene.gaussians import PARAMETERS, Scene

BOUNDARY = 0.5  # Gaussians with a score above were kept by the job


def lowest(score: np.ndarray, count: int) -> float:
    """The lowest of the `count` highest scores; -inf if count >= N, inf if count < 1. score (N,)."""
    if count >= len(score):
        return -np.inf
    return np.inf if count < 1 else float(np.partition(score, len(score) - count)[len(score) - count])


def numbered(count: int) -> np.ndarray:
    """The row numbers 0 to count - 1, int32."""
    return np.arange(count, dtype=np.int32)


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
