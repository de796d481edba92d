"""Peak signal-to-noise ratio of two images."""

from __future__ import annotations

import math

import numpy as np

from .arrays import image_pair


def psnr(a: np.ndarray, b: np.ndarray) -> float:
    """PSNR in dB: 10 log10(1 / MSE), with the mean squared error over all pixels and channels.

    a, b: (H, W, 3) in [0, 1]. Equal images give math.inf. JSON has no infinity, so store null and print ∞.
    Raises SceneError.
    """
    a, b = image_pair(a, b)
    difference = (a - b).ravel()
    # float64 sum without a float64 copy of the image
    error = float(np.einsum("i,i", difference, difference, dtype=np.float64)) / difference.size
    return math.inf if error == 0.0 else 10.0 * math.log10(1.0 / error)


def with_error(value: float, error: float) -> float:
    """The PSNR in dB after a mean squared error, colours in 0..1, is added to that of a PSNR. error 0: the
    same value."""
    return -10.0 * math.log10(10.0 ** (-value / 10.0) + error) if error else value
