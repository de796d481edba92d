"""LightGaussian (arXiv 2311.17245): one cut by global significance GS removes 66 % of the Gaussians; its
recovery follows.

    GS_j = gamma_j * (sum over views and the pixels that j hits of opacity_j T)
    gamma_j = min(1, V_j / V_90)^0.1

V_j is the product of the three scales, V_90 its 90th percentile. This is the form of the paper, with T and
with the clamp at 1. The first published code left T out, used the 10th percentile and did not clamp.
"""

from __future__ import annotations

import numpy as np

from ..scores import significance
from .ranked import Ranked

VOLUME_POWER = 0.1
VOLUME_RANK = 0.9  # rank of the volume that volumes are divided by, as a share


def volume_factor(log_scales: np.ndarray) -> np.ndarray:
    """gamma (N,) float64 from log-scales (N, 3). Computed with logarithms, so that no volume underflows."""
    if not len(log_scales):
        return np.zeros(0)
    volumes = log_scales.astype(np.float64).sum(axis=1)
    largest = np.sort(volumes)[int(VOLUME_RANK * (len(volumes) - 1))]
    return np.exp(VOLUME_POWER * np.minimum(volumes - largest, 0.0))


METHODS = (
    Ranked(
        "lightgaussian",
        "removes, in one cut, the Gaussians of lowest significance (opacity, size, visibility)",
        13,
        "LightGaussian",
        share=0.34,
        source="LightGaussian, arXiv 2311.17245",
        ranking=lambda viewed: significance(viewed) * volume_factor(viewed.scene.log_scales),
    ),
)
