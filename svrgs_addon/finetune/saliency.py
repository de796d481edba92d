"""Saliency of a Gaussian: its removal error over its mask penalty, computed without sampling masks.

The colour C of a pixel and its spatial mask F are linear in the existence M of one Gaussian. So the removal
of one Gaussian changes them by exactly their derivatives:

    removal error = sum over views of the mean over all pixels of |dC/dM|^2 / 3,   dC/dM = alpha T (c - b)
    mask penalty  = SHARE * sum over views of the mean over its own pixels of 2 F dF/dM
    saliency      = removal error / mask penalty                                    in units of lambda_F

b is the colour that the pixel would have if the ray began behind the Gaussian. The removal error is the Delta
SE of GaussianPOP (arXiv 2602.06830): the squared error that the removal of this Gaussian alone would cause.
The mask penalty is what the Gaussian adds to F^2, to first order. The objective of SVR-GS (arXiv 2509.11116,
Eq. 10) falls when a Gaussian with a saliency below lambda_F is removed. "Its own pixels" are those in which
it is blended. So each Gaussian is charged for the same SHARE of an image, whatever its size, because each
needs the same memory and time. The paper charges by pixel.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from ..native.rasterizer import Rasterizer
from ..scene.camera import Camera
from .viewed_scene import REDUCTION, ViewedScene

SHARE = 4e-7  # share of an image that each Gaussian is charged for


def removal_errors(
    viewed: ViewedScene, kept: np.ndarray | None = None, reduction: int = REDUCTION
) -> np.ndarray:
    """Removal error of each Gaussian, (N,) float64: squared error of colours in 0..1, summed over views. 0
    for Gaussians that no view sees.

    kept: (N,) bool, the Gaussians that the scene is rendered with; the others have 0. None: all. reduction:
    of the pictures, per side.
    """
    total, masks = np.zeros(viewed.scene.count), None if kept is None else kept.astype(np.uint8)
    for camera, _ in viewed.reduced(reduction).rendered(masks):
        total += _removal_error(viewed.rasterizer, camera, len(total))
    return total


def views_that_see(viewed: ViewedScene) -> np.ndarray:
    """In how many views, at half size, the removal of each Gaussian would change a pixel, (N,) int64."""
    views = np.zeros(viewed.scene.count, np.int64)
    for camera, _ in viewed.reduced().rendered():
        views += _removal_error(viewed.rasterizer, camera, len(views)) > 0
    return views


def saliency(viewed: ViewedScene) -> np.ndarray:
    """Saliency of each Gaussian, (N,) float64, in units of lambda_F. 0 for Gaussians that no view sees."""
    n, rasterizer = viewed.scene.count, viewed.rasterizer
    removal_error, mask_penalty = np.zeros(n), np.zeros(n)
    masked = replace(viewed.reduced(), options=replace(viewed.options, mask_kind="svr"))
    for camera, images in masked.rendered(outputs=("mask",)):
        removal_error += _removal_error(rasterizer, camera, n)
        pixels = np.zeros(n, np.int64)
        rasterizer.add_scores(hits=pixels)
        F, ids = images["mask"], rasterizer.visible()
        d_masks = rasterizer.backward({"mask": 2 * F}, ("masks",))["masks"]
        mask_penalty[ids] += SHARE * d_masks / np.maximum(pixels[ids], 1)
    return np.divide(removal_error, mask_penalty, out=np.zeros(n), where=mask_penalty > 0)


def _removal_error(rasterizer: Rasterizer, view: Camera, count: int) -> np.ndarray:
    """Removal errors in the view that was rendered last, (N,) float64."""
    sums = np.zeros(count)
    rasterizer.add_removal(sums, np.zeros((view.height, view.width, 3), rasterizer.dtype))
    return sums / (3 * view.height * view.width)
