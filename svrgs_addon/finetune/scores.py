"""Scores that rank Gaussians without learning: their contribution to a set of views."""

from __future__ import annotations

import numpy as np

from ..camera import Camera
from ..native import Rasterizer, RenderOptions
from ..scene import Scene
from .model import Model


def contribution(scene: Scene, cameras: list[Camera], rasterizer: Rasterizer, options: RenderOptions) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Of each Gaussian over all views, (N,) each: sum of alpha T (float64), largest alpha T (float32), pixels in which it is blended (int64)."""
    sums, peaks, pixels, _ = _statistics(scene, cameras, rasterizer, options)
    return sums, peaks, pixels


def significance(scene: Scene, cameras: list[Camera], rasterizer: Rasterizer, options: RenderOptions) -> np.ndarray:
    """Opacity times the sum of T over all views and the pixels in which the Gaussian is blended, (N,) float64 (LightGaussian)."""
    *_, transmittance = _statistics(scene, cameras, rasterizer, options)
    return transmittance / (1 + np.exp(-scene.opacity_logits.astype(np.float64)))


def slopes(scene: Scene | Model, cameras: list[Camera], rasterizer: Rasterizer, options: RenderOptions) -> np.ndarray:
    """Sum over all views and pixels of the squared derivative of the colour, its channels summed, with respect to the value of the
    Gaussian at the pixel, (N,) float64 (Speedy-Splat)."""
    sums = np.zeros(scene.count)
    for camera in cameras:
        rasterizer.forward(scene, camera, options, outputs=())
        rasterizer.add_slopes(sums)
    return sums


def _statistics(scene: Scene, cameras: list[Camera], rasterizer: Rasterizer, options: RenderOptions) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    n = scene.count
    arrays = np.zeros(n), np.zeros(n, np.float32), np.zeros(n, np.int64), np.zeros(n)
    for camera in cameras:
        rasterizer.forward(scene, camera, options, outputs=())
        rasterizer.add_scores(*arrays)
    return arrays


def top(score: np.ndarray, count: int) -> np.ndarray:
    """(N,) bool: True for the `count` highest scores (N,). Of equal scores, the earlier row wins."""
    order = np.lexsort((np.arange(len(score)), -score))
    keep = np.zeros(len(score), bool)
    keep[order[:count]] = True
    return keep
