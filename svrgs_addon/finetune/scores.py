"""Scores that rank Gaussians once, without learning: what they contribute to a set of views."""

from __future__ import annotations

import numpy as np

from ..camera import Camera
from ..native import Rasterizer, RenderOptions
from ..scene import Scene


def contribution(scene: Scene, cameras: list[Camera], rasterizer: Rasterizer, options: RenderOptions) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Per Gaussian over all views: sum of alpha T (float64), its maximum (float32), pixels blended (int64); (N,) each."""
    sums, peaks, pixels, _ = _statistics(scene, cameras, rasterizer, options)
    return sums, peaks, pixels


def significance(scene: Scene, cameras: list[Camera], rasterizer: Rasterizer, options: RenderOptions) -> np.ndarray:
    """(N,) float64: sum over views and the pixels a Gaussian is blended in of its opacity times T (LightGaussian)."""
    *_, transmittance = _statistics(scene, cameras, rasterizer, options)
    return transmittance / (1 + np.exp(-scene.opacity_logits.astype(np.float64)))


def _statistics(scene: Scene, cameras: list[Camera], rasterizer: Rasterizer, options: RenderOptions) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    n = scene.count
    arrays = np.zeros(n), np.zeros(n, np.float32), np.zeros(n, np.int64), np.zeros(n)
    for camera in cameras:
        rasterizer.forward(scene, camera, options, outputs=())
        rasterizer.add_scores(*arrays)
    return arrays


def top(score: np.ndarray, count: int) -> np.ndarray:
    """(N,) bool: the `count` highest scores; ties go to the earlier row."""
    order = np.lexsort((np.arange(len(score)), -score))
    keep = np.zeros(len(score), bool)
    keep[order[:count]] = True
    return keep
