"""3DGS adaptive density control: clone small Gaussians, split large ones, where the image still pulls at their centres."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from ..geometry.rotations import rotation_matrices
from .model import Model
from .settings import Densify

RESET_OPACITY = 0.01


class Statistics:
    """Per-Gaussian mean of |dL/d(projected centre)|, in units of half the image, since the last densification."""

    def __init__(self, count: int):
        self.total = np.zeros(count, np.float32)
        self.views = np.zeros(count, np.int32)

    def add(self, visible: np.ndarray, means2d: np.ndarray, width: int, height: int):
        """visible (V,) ids; means2d (V, 2) gradients in pixels."""
        rows = visible.astype(np.intp)  # once, not at each of the four accesses
        self.total[rows] += np.hypot(means2d[:, 0] * (0.5 * width), means2d[:, 1] * (0.5 * height))
        self.views[rows] += 1

    def mean(self) -> np.ndarray:
        return self.total / np.maximum(self.views, 1)  # never seen: 0


def densify(
    model: Model, statistics: Statistics, rule: Densify, extent: float, rng: np.random.Generator, fits: Callable[[int], bool] = lambda _: True
) -> np.ndarray:
    """Adds clones and the children of splits to the model, if so many fit; returns (N,) bool, False for the parents to be removed."""
    largest = np.exp(model.log_scales.max(axis=1))
    pulled = statistics.mean() >= rule.gradient
    small = largest <= rule.small * extent
    clone, split = np.flatnonzero(pulled & small), np.flatnonzero(pulled & ~small)
    born = np.concatenate([clone, np.repeat(split, rule.split_into)])
    if not len(born) or not fits(len(born)):
        return np.ones(model.count, bool)
    rows = {name: value[born] for name, value in model.values.items()}
    _place_children(rows, len(clone), rule, rng)
    model.append(rows)
    stays = np.ones(model.count, bool)
    stays[split] = False
    return stays


def worth_keeping(model: Model, rule: Densify, extent: float, after_reset: bool) -> np.ndarray:
    """(N,) bool: not too faint, and after the first opacity reset not too large. (The published screen-size rule never fires.)"""
    keep = model.opacity_logits >= np.log(rule.min_opacity / (1 - rule.min_opacity))
    if after_reset:
        keep &= np.exp(model.log_scales.max(axis=1)) <= rule.max_scale * extent
    return keep


def _place_children(rows: dict[str, np.ndarray], clones: int, rule: Densify, rng: np.random.Generator):
    """Children of a split are drawn from their parent's own Gaussian and shrunk; clones stay where they are."""
    if len(rows["means"]) == clones:
        return
    children = slice(clones, None)
    scales = np.exp(rows["log_scales"][children])
    offsets = rng.standard_normal(scales.shape) * scales
    rows["means"][children] += np.einsum("nij,nj->ni", rotation_matrices(rows["quats"][children]), offsets)
    rows["log_scales"][children] -= np.log(rule.split_shrink)


def reset_opacity(model: Model):
    """opacity <- min(opacity, 0.01), its moments zeroed."""
    limit = np.log(RESET_OPACITY / (1 - RESET_OPACITY))
    np.minimum(model.opacity_logits, limit, out=model.values["opacity_logits"])
    model.moments["opacity_logits"][:] = 0
