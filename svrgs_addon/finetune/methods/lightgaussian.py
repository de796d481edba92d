"""LightGaussian (arXiv 2311.17245): 66 % of a trained scene goes at once, by global significance; then its recovery.

    GS_j = gamma_j sum over views and pixels that j hits of opacity_j T,    gamma_j = min(1, V_j / V_90)^0.1

V_j is the product of the scales. Of the two forms in circulation this is the paper's: T counts, and volumes are normalised by
their 90th percentile and clamped at 1. The published code first left T out, takes the 10th percentile and clamps nothing.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from ..scores import significance
from .scores import Ranked

VOLUME_POWER = 0.1
VOLUME_RANK = 0.9  # share of the volumes that are no larger than the one that counts as 1


def global_significance(scene, cameras, rasterizer, options) -> np.ndarray:
    """(N,) float64."""
    return significance(scene, cameras, rasterizer, options) * volume_factor(scene.log_scales)


def volume_factor(log_scales: np.ndarray) -> np.ndarray:
    """gamma (N,) from log-scales (N, 3); in logarithms, so that no volume is too small to count."""
    if not len(log_scales):
        return np.zeros(0)
    volumes = log_scales.astype(np.float64).sum(axis=1)
    largest = np.sort(volumes)[int(VOLUME_RANK * (len(volumes) - 1))]
    return np.exp(VOLUME_POWER * np.minimum(volumes - largest, 0.0))


@dataclass
class LightGaussian(Ranked):
    """The recovery is the one all methods here have."""

    rank: Callable[..., np.ndarray] = global_significance
    share: float = 0.34
