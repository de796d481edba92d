"""What a Gaussian's existence is worth to the objective of SVR-GS, by closed differences instead of sampled masks.

A colour and the spatial mask F are linear in the existence M of one Gaussian, so its absence changes them by their derivatives:

    cost = sum over views of the mean over all pixels of |dC/dM|^2 / 3,  dC/dM = alpha T (c - b)     the squared error without it
    push = SHARE * sum over views of the mean over its own pixels of 2 F dF/dM                       what it adds to F^2, to first order

worth = cost / push. The objective gains from pruning what is worth less than lambda_F. Each Gaussian is charged for the same SHARE
of a picture, however much of it it covers: it costs memory and time as one.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from ..camera import Camera
from ..native import Rasterizer, RenderOptions
from ..scene import Scene
from .model import Model
from .views import fitting_reduction

SHARE = 4e-7
REDUCTION = 2  # views are looked at at half their size: nearly the same ranking in a fraction of the time


def cost_and_push(scene: Scene | Model, cameras: list[Camera], rasterizer: Rasterizer, options: RenderOptions) -> tuple[np.ndarray, np.ndarray]:
    """(N,) float64 each; 0 for what no view sees."""
    n, options = scene.count, replace(options, mask_kind="svr")
    cost, push = np.zeros(n), np.zeros(n)
    for camera in cameras:
        view = camera.reduced(fitting_reduction(REDUCTION, camera.width, camera.height))
        F = rasterizer.forward(scene, view, options, outputs=("mask",))["mask"]
        seen, pixels = np.zeros(n), np.zeros(n, np.int64)
        rasterizer.add_removal(seen, np.zeros((*F.shape, 3), F.dtype))
        cost += seen / (3 * F.size)
        rasterizer.add_scores(np.zeros(n), np.zeros(n, np.float32), pixels)
        ids = rasterizer.visible()
        push[ids] += SHARE * rasterizer.backward({"mask": 2 * F}, ("masks",))["masks"] / np.maximum(pixels[ids], 1)
    return cost, push


def worth(scene: Scene | Model, cameras: list[Camera], rasterizer: Rasterizer, options: RenderOptions) -> np.ndarray:
    """(N,) float64, in units of lambda_F; 0 for what no view sees."""
    cost, push = cost_and_push(scene, cameras, rasterizer, options)
    return np.divide(cost, push, out=np.zeros(scene.count), where=push > 0)
