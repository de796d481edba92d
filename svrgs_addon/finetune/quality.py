"""Quality on a few training views: what a drop in PSNR is measured on, and the fewest Gaussians that stay within it."""

from __future__ import annotations

import numpy as np

from .run_view import RunView
from .scores import top

VIEWS = 6  # training views, evenly spread over the dataset


def quality_views(train_indices: list[int]) -> list[int]:
    """The training views that a drop in PSNR is measured on."""
    return train_indices[:: max(1, len(train_indices) // VIEWS)][:VIEWS]


def fewest_within(run: RunView, score: np.ndarray, floor: float) -> np.ndarray:
    """(N,) bool: the fewest Gaussians with the highest scores (N,) whose PSNR is at least `floor` dB; by bisection to 0.1 % of N."""
    few, enough = 0, run.model.count
    while enough - few > max(1, run.model.count // 1_000):
        middle = (few + enough) // 2
        within = run.psnr(top(score, middle)) >= floor
        few, enough = (few, middle) if within else (middle, enough)
    return top(score, enough)
