"""PSNR on a few training views: the views on which a drop is measured, and the fewest Gaussians that reach a given PSNR."""

from __future__ import annotations

import numpy as np

from .run_view import RunView
from .scores import top

VIEWS = 6  # number of training views, spread evenly over the dataset


def quality_views(train_indices: list[int]) -> list[int]:
    """The training views on which a drop in PSNR is measured."""
    return train_indices[:: max(1, len(train_indices) // VIEWS)][:VIEWS]


def fewest_within(run: RunView, score: np.ndarray, floor: float) -> np.ndarray:
    """(N,) bool: the Gaussians of highest score, as few as have a PSNR of at least `floor` dB. score (N,). Bisection to 0.1 % of N."""
    few, enough = 0, run.model.count
    while enough - few > max(1, run.model.count // 1_000):
        middle = (few + enough) // 2
        within = run.psnr(top(score, middle)) >= floor
        few, enough = (few, middle) if within else (middle, enough)
    return top(score, enough)
