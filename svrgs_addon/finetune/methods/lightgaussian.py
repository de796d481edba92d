"""LightGaussian (arXiv 2311.17245): 66 % of a trained scene is removed at once, by global significance; its recovery follows.

    GS_j = gamma_j sum over views and pixels that j hits of opacity_j T,    gamma_j = min(1, V_j / V_90)^0.1

V_j is the product of the scales. This is the form of the paper: T counts, and volumes are divided by their 90th percentile and
clamped at 1. The published code first left T out, takes the 10th percentile, and does not clamp.
"""

from __future__ import annotations

import numpy as np

from ..scores import significance
from .ranked import Ranked

VOLUME_POWER = 0.1
VOLUME_RANK = 0.9  # percentile of the volume that counts as 1


class LightGaussian(Ranked):
    def score(self, scene, cameras, rasterizer, options) -> np.ndarray:
        return significance(scene, cameras, rasterizer, options) * volume_factor(scene.log_scales)


def volume_factor(log_scales: np.ndarray) -> np.ndarray:
    """gamma (N,) from log-scales (N, 3); in logarithms, so that no volume underflows."""
    if not len(log_scales):
        return np.zeros(0)
    volumes = log_scales.astype(np.float64).sum(axis=1)
    largest = np.sort(volumes)[int(VOLUME_RANK * (len(volumes) - 1))]
    return np.exp(VOLUME_POWER * np.minimum(volumes - largest, 0.0))


METHODS = (LightGaussian("lightgaussian", "LightGaussian: ranks the Gaussians once, by global significance", 13, share=0.34),)
