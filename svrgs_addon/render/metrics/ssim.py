"""Structural similarity, SSIM (Wang et al. 2004), in the form that 3DGS reports."""

from __future__ import annotations

import numpy as np

from ...native.rasterizer import Rasterizer
from .arrays import image_pair


def ssim(a: np.ndarray, b: np.ndarray) -> float:
    """Mean SSIM over pixels and channels, in [-1, 1]; higher is better, 1: equal images.

    a, b: (H, W, 3) in [0, 1]. Each channel is filtered with a Gaussian window of 11 x 11 pixels and σ = 1.5
    pixels. The images are padded with zeros. It is computed as in the loss of fine-tuning. Raises SceneError,
    and NativeError if a side is longer than 32,768 pixels.
    """
    return Rasterizer().loss(*image_pair(a, b), want_grad=False)[1]
