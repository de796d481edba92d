"""Fewer or more Gaussians than a job kept: by its scores (ranking.py), recovered ones and those it had dropped in one scene."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from ..scene import Scene

BOUNDARY = 0.5  # scores above: kept by the job
ARRAYS = ("means", "log_scales", "quats", "opacity_logits", "sh")


def lowest(score: np.ndarray, count: int) -> float:
    """The lowest of the `count` highest scores (N,)."""
    if count >= len(score):
        return -np.inf
    return np.inf if count < 1 else float(np.partition(score, len(score) - count)[len(score) - count])


def numbered(count: int) -> np.ndarray:
    """(count,) int32 row numbers."""
    return np.arange(count, dtype=np.int32)


def merged(a: Scene, rows_a: np.ndarray, b: Scene, rows_b: np.ndarray) -> Scene:
    """Both scenes' Gaussians, in the order of their rows in the source; columns that both have."""
    join = lambda name: np.concatenate([getattr(a, name), getattr(b, name)])  # noqa: E731
    attributes = {name: np.concatenate([column, b.attributes[name]]) for name, column in a.attributes.items() if name in b.attributes}
    whole = replace(a, **{name: join(name) for name in ARRAYS}, attributes=attributes)
    return whole.select(np.argsort(np.concatenate([rows_a, rows_b]), kind="stable"))
