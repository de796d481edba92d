"""LDR-FLIP: the difference that a viewer sees when flipping between two images.

Reference: P. Andersson, J. Nilsson, T. Akenine-Möller, M. Oskarsson, K. Åström, M. D. Fairchild: "FLIP: A
Difference Evaluator for Alternating Images", HPG 2020 (doi 10.1145/3406183). Computed by the native library
(svrgs_flip).

Accuracy, measured against the authors' flip-evaluator 1.7 on nine pairs of 720 x 537 photographs (noise,
blur, two views) and on random images: means agree within 6e-6, single pixels within 6e-5.
"""

from __future__ import annotations

import numpy as np

from ...native.pictures import flip_errors
from .arrays import image_pair

# 67.02: a monitor 0.7 m wide with 3840 pixels, seen from 0.7 m
PIXELS_PER_DEGREE = 0.7 * (3840 / 0.7) * np.pi / 180


def flip(a: np.ndarray, b: np.ndarray, ppd: float = PIXELS_PER_DEGREE) -> float:
    """Mean of flip_map() in [0, 1]; lower is better, 0: equal images."""
    return float(np.mean(flip_map(a, b, ppd), dtype=np.float64))


def flip_map(a: np.ndarray, b: np.ndarray, ppd: float = PIXELS_PER_DEGREE) -> np.ndarray:
    """FLIP of each pixel, (H, W) float32 in [0, 1]; symmetric in a and b (equation 13).

    a, b: (H, W, 3) display sRGB in [0, 1]. ppd: pixels per degree of the viewer's visual angle, 1 to 400.
    Raises SceneError, and NativeError for another ppd or a side of more than 32,768 pixels.
    """
    return flip_errors(*image_pair(a, b), ppd)
