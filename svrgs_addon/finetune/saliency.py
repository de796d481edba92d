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


def costs(scene: Scene | Model, cameras: list[Camera], rasterizer: Rasterizer, options: RenderOptions) -> np.ndarray:
    """(N,) float64; 0 for what no view sees."""
    cost = np.zeros(scene.count)
    for view in _reduced(cameras):
        rasterizer.forward(scene, view, options, outputs=())
        cost += _cost_of(rasterizer, view, scene.count)
    return cost


def worth(scene: Scene | Model, cameras: list[Camera], rasterizer: Rasterizer, options: RenderOptions) -> np.ndarray:
    """(N,) float64, in units of lambda_F; 0 for what no view sees."""
    n, options = scene.count, replace(options, mask_kind="svr")
    cost, push = np.zeros(n), np.zeros(n)
    for view in _reduced(cameras):
        F = rasterizer.forward(scene, view, options, outputs=("mask",))["mask"]
        cost += _cost_of(rasterizer, view, n)
        pixels = np.zeros(n, np.int64)
        rasterizer.add_scores(np.zeros(n), np.zeros(n, np.float32), pixels)
        ids = rasterizer.visible()
        push[ids] += SHARE * rasterizer.backward({"mask": 2 * F}, ("masks",))["masks"] / np.maximum(pixels[ids], 1)
    return np.divide(cost, push, out=np.zeros(n), where=push > 0)


def _reduced(cameras: list[Camera]) -> list[Camera]:
    return [camera.reduced(fitting_reduction(REDUCTION, camera.width, camera.height)) for camera in cameras]


def _cost_of(rasterizer: Rasterizer, view: Camera, count: int) -> np.ndarray:
    """The share (N,) of the view that was just drawn in the cost."""
    sums = np.zeros(count)
    rasterizer.add_removal(sums, np.zeros((view.height, view.width, 3), rasterizer.dtype))
    return sums / (3 * view.height * view.width)
