"""Structural similarity, SSIM (Wang et al. 2004), in the form that 3DGS reports."""

from __future__ import annotations

import numpy as np

from .arrays import Window, filter_separable, image_pair, over_tiles

C1 = 0.01**2  # (K1 L)², L = 1
C2 = 0.03**2
WINDOW, SIGMA = 11, 1.5  # pixels


def ssim(a: np.ndarray, b: np.ndarray) -> float:
    """Mean SSIM over pixels and channels, in [-1, 1]; higher is better, 1: equal images.

    a, b: (H, W, 3) in [0, 1]. Each channel is filtered with a Gaussian window of 11 x 11 pixels and σ = 1.5 pixels. The images are
    padded with zeros. Raises SceneError.
    """
    a, b = image_pair(a, b)
    x = np.arange(WINDOW) - WINDOW // 2
    taps = np.exp(-(x**2) / (2 * SIGMA**2))
    taps = taps / taps.sum()

    def tile_sum(outer: Window, inner: Window) -> float:
        return sum(float(np.sum(_channel_map(a[*outer, c], b[*outer, c], taps)[inner], dtype=np.float64)) for c in range(3))

    return sum(over_tiles(tile_sum, a.shape, WINDOW // 2)) / a.size


def _channel_map(a: np.ndarray, b: np.ndarray, taps: np.ndarray) -> np.ndarray:
    """SSIM of each pixel of one channel (H, W)."""
    # Only the sum of the two variances is needed, so four filtered images are enough instead of five.
    moments = np.stack([a, b, a * a + b * b, a * b])
    mean_a, mean_b, mean_squares, mean_product = filter_separable(moments, taps, taps, "constant")
    product, squares = mean_a * mean_b, mean_a**2 + mean_b**2
    luminance = (2 * product + C1) / (squares + C1)
    structure = (2 * (mean_product - product) + C2) / (mean_squares - squares + C2)
    return luminance * structure
