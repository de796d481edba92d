"""Scores that rank Gaussians without learning: their contribution to a set of views."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from .viewed_scene import ViewedScene


def contribution(viewed: ViewedScene) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Of each Gaussian over all views, (N,) each: sum of alpha T (float64), largest alpha T (float32), pixels
    in which it is blended (int64)."""
    sums, peaks, pixels, _ = _statistics(viewed)
    return sums, peaks, pixels


def significance(viewed: ViewedScene) -> np.ndarray:
    """Opacity times the sum of T over all pixels in which it is blended, (N,) float64 (LightGaussian)."""
    *_, transmittance = _statistics(viewed)
    return transmittance / (1 + np.exp(-viewed.scene.opacity_logits.astype(np.float64)))


def slopes(viewed: ViewedScene) -> np.ndarray:
    """Sum over all views and pixels of the squared derivative of the colour, its channels summed, with
    respect to the value of the Gaussian at the pixel, (N,) float64 (Speedy-Splat)."""
    return _sums(viewed, viewed.rasterizer.add_slopes)


def dominance(viewed: ViewedScene) -> np.ndarray:
    """The number of pixels of all views in which the Gaussian has the largest alpha T, (N,) float64."""
    return _sums(viewed, viewed.rasterizer.add_dominance)


def _sums(viewed: ViewedScene, add: Callable[[np.ndarray], None]) -> np.ndarray:
    """What add() adds for each view, (N,) float64."""
    sums = np.zeros(viewed.scene.count)
    for _ in viewed.rendered():
        add(sums)
    return sums


def importance(viewed: ViewedScene, by_area: bool) -> np.ndarray:
    """Sum of alpha T over all pixels and views, (N,) float64; 0 for Gaussians that dominate no pixel
    (Mini-Splatting).

    by_area: the sum of each view is divided by its number of pixels, and only views in which the Gaussian
    dominates a pixel count.
    """
    n = viewed.scene.count
    total, dominated = np.zeros(n), np.zeros(n, bool)
    for _ in viewed.rendered():
        sums, pixels, dominant = np.zeros(n), np.zeros(n, np.int64), np.zeros(n)
        viewed.rasterizer.add_scores(sums, hits=pixels)
        viewed.rasterizer.add_dominance(dominant)
        total += np.where(dominant > 0, sums / np.maximum(pixels, 1), 0) if by_area else sums
        dominated |= dominant > 0
    return np.where(dominated, total, 0)


def drawn(score: np.ndarray, count: int, key: list[int]) -> np.ndarray:
    """(N,) bool: `count` Gaussians drawn without replacement, with probabilities proportional to score (N,),
    by Gumbel noise on log score. Those with a score of 0 are taken only if there are too few others. key: of
    the random numbers."""
    with np.errstate(divide="ignore"):
        return top(np.log(score) + np.random.default_rng(key).gumbel(size=len(score)), count)


def _statistics(viewed: ViewedScene) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    n = viewed.scene.count
    arrays = np.zeros(n), np.zeros(n, np.float32), np.zeros(n, np.int64), np.zeros(n)
    for _ in viewed.rendered():
        viewed.rasterizer.add_scores(*arrays)
    return arrays


def top(score: np.ndarray, count: int) -> np.ndarray:
    """(N,) bool: True for the `count` highest scores (N,). Of equal scores, the earlier row wins."""
    order = np.lexsort((np.arange(len(score)), -score))
    keep = np.zeros(len(score), bool)
    keep[order[:count]] = True
    return keep
