"""Peak signal-to-noise ratio of one image."""

from __future__ import annotations

import math

import numpy as np

from .arrays import image_pair


def psnr(a: np.ndarray, b: np.ndarray) -> float:
    """10 log10(1 / mean squared difference) in dB, the mean over all pixels and channels.

    a, b: (H, W, 3) in [0, 1]. Equal images give math.inf, which JSON cannot hold: write null and print ∞.
    """
    a, b = image_pair(a, b)
    difference = (a - b).ravel()
    error = float(np.einsum("i,i", difference, difference, dtype=np.float64)) / difference.size  # summed in doubles, without an image of them
    return math.inf if error == 0.0 else 10.0 * math.log10(1.0 / error)
