"""Structural similarity (Wang et al. 2004) in the form that 3DGS reports."""

from __future__ import annotations

import numpy as np

from .arrays import filter_separable, image_pair

C1 = 0.01**2  # (K1 L)², L = 1
C2 = 0.03**2
WINDOW, SIGMA = 11, 1.5


def ssim(a: np.ndarray, b: np.ndarray) -> float:
    """Mean over pixels and channels, in [-1, 1]; 1 for equal images.

    a, b: (H, W, 3) in [0, 1]. Gaussian window 11 x 11, σ 1.5, per channel; beyond the border the images are zero.
    """
    a, b = image_pair(a, b)
    x = np.arange(WINDOW) - WINDOW // 2
    taps = np.exp(-(x**2) / (2 * SIGMA**2))
    taps = taps / taps.sum()
    return float(np.mean([_channel_mean(a[..., c], b[..., c], taps) for c in range(3)]))


def _channel_mean(a: np.ndarray, b: np.ndarray, taps: np.ndarray) -> float:
    # The two variances are only ever needed as their sum, so four windowed means do instead of five.
    moments = np.stack([a, b, a * a + b * b, a * b])
    mean_a, mean_b, mean_squares, mean_product = filter_separable(moments, taps, taps, "constant")
    product, squares = mean_a * mean_b, mean_a**2 + mean_b**2
    luminance = (2 * product + C1) / (squares + C1)
    structure = (2 * (mean_product - product) + C2) / (mean_squares - squares + C2)
    return float(np.mean(luminance * structure, dtype=np.float64))
