"""Scores that rank Gaussians once, without learning: opacity, and contribution to the training views."""

from __future__ import annotations

import numpy as np

from ..camera import Camera
from ..native import Rasterizer, RenderOptions
from ..scene import Scene


def contribution(scene: Scene, cameras: list[Camera], rasterizer: Rasterizer, options: RenderOptions) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Per Gaussian over all views: sum of alpha T (float64), its maximum (float32), pixels blended (int64); (N,) each."""
    sums, peaks, hits = np.zeros(scene.count), np.zeros(scene.count, np.float32), np.zeros(scene.count, np.int64)
    for camera in cameras:
        rasterizer.forward(scene, camera, options, outputs=())
        rasterizer.add_scores(sums, peaks, hits)
    return sums, peaks, hits


def top(score: np.ndarray, count: int) -> np.ndarray:
    """(N,) bool: the `count` highest scores; ties go to the earlier row."""
    order = np.lexsort((np.arange(len(score)), -score))
    keep = np.zeros(len(score), bool)
    keep[order[:count]] = True
    return keep
