"""PSNR, SSIM and FLIP of two images."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from ...native.pictures import flip_errors
from ...native.rasterizer import Rasterizer
from ...system.errors import SceneError

SHOWN = 0.001  # share of the pixels of a picture; with fewer it is almost empty
# 67.02: a monitor 0.7 m wide with 3840 pixels, seen from 0.7 m
PIXELS_PER_DEGREE = 0.7 * (3840 / 0.7) * np.pi / 180


def image_pair(a: np.ndarray, b: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Both images as contiguous float32. Raises SceneError unless both are (H, W, 3), alike and finite."""
    a, b = np.ascontiguousarray(a, np.float32), np.ascontiguousarray(b, np.float32)
    if a.shape != b.shape or a.ndim != 3 or a.shape[2] != 3 or a.size == 0:
        raise SceneError(f"cannot compare images of shapes {a.shape} and {b.shape}; both must be (H, W, 3)")
    if not (np.isfinite(a).all() and np.isfinite(b).all()):
        raise SceneError("cannot compare images that hold NaN or infinite values")
    return a, b


def psnr(a: np.ndarray, b: np.ndarray, share: float = 1.0) -> float:
    """PSNR in dB: 10 log10(1 / MSE), with the mean squared error over all channels of the pixels that count.

    a, b: (H, W, 3) in [0, 1]. share: of the pixels that count (Camera.valid_share); the others
    are equal. Equal images give math.inf. JSON has no infinity, so store null and print ∞.
    Raises SceneError.
    """
    a, b = image_pair(a, b)
    difference = (a - b).ravel()
    # float64 sum without a float64 copy of the image
    error = float(np.einsum("i,i", difference, difference, dtype=np.float64)) / (difference.size * share)
    return math.inf if error == 0.0 else 10.0 * math.log10(1.0 / error)


def almost_empty(image: np.ndarray, background: Sequence[float]) -> bool:
    """Whether fewer than SHOWN of the pixels differ from the background by more than one step of 8 bits: any
    two such pictures are alike. image: (H, W, 3), display sRGB 0..1."""
    differs = (np.abs(image - np.array(background, np.float32)) > 1.5 / 255).any(axis=2)
    return bool(differs.mean() < SHOWN)


def with_error(value: float, error: float) -> float:
    """The PSNR in dB after a mean squared error, colours in 0..1, is added; error 0: the same value."""
    return -10.0 * math.log10(10.0 ** (-value / 10.0) + error) if error else value


def ssim(a: np.ndarray, b: np.ndarray) -> float:
    """Mean SSIM (Wang et al. 2004) over pixels and channels, in [-1, 1]; higher is better, 1: equal images.

    a, b: (H, W, 3) in [0, 1]. As 3DGS reports it, and as in the loss of fine-tuning: each channel is filtered
    with a Gaussian window of 11 x 11 pixels and σ = 1.5 pixels; the images are padded with zeros. Raises
    SceneError, and NativeError if a side is longer than 32,768 pixels.
    """
    return Rasterizer().loss(*image_pair(a, b), want_grad=False)[1]


def flip(a: np.ndarray, b: np.ndarray, ppd: float = PIXELS_PER_DEGREE) -> float:
    """Mean of flip_map() in [0, 1]; lower is better, 0: equal images."""
    return float(np.mean(flip_map(a, b, ppd), dtype=np.float64))


def flip_map(a: np.ndarray, b: np.ndarray, ppd: float = PIXELS_PER_DEGREE) -> np.ndarray:
    """LDR-FLIP of each pixel, the difference that a viewer sees when flipping between two images: (H, W)
    float32 in [0, 1]; symmetric in a and b (equation 13 of Andersson et al., "FLIP: A Difference Evaluator
    for Alternating Images", HPG 2020, doi 10.1145/3406183).

    a, b: (H, W, 3) display sRGB in [0, 1]. ppd: pixels per degree of the viewer's visual angle, 1 to 400.
    Against the authors' flip-evaluator 1.7, on nine pairs of 720 x 537 photographs (noise, blur, two views)
    and on random images, means agree within 6e-6, single pixels within 6e-5. Raises SceneError, and
    NativeError for another ppd or a side of more than 32,768 pixels.
    """
    return flip_errors(*image_pair(a, b), ppd)
