"""Adaptive density control of 3DGS (section 5.2): it clones small Gaussians and splits large ones whose
position gradient is large."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from ..scene.rotations import rotation_matrices
from .model import Model
from .settings import Densify

RESET_OPACITY = 0.01


class Statistics:
    """Mean norm of dL/d(projected centre) since the last densification, in units of half the image."""

    def __init__(self, count: int):
        self.total = np.zeros(count, np.float32)
        self.views = np.zeros(count, np.int32)

    def add(self, visible: np.ndarray, means2d: np.ndarray, width: int, height: int):
        """Adds one view: visible (V,) rows, means2d (V, 2) gradients per pixel, its size in pixels."""
        rows = visible.astype(np.intp)  # NumPy would convert it at each of the four accesses
        self.total[rows] += np.hypot(means2d[:, 0] * (0.5 * width), means2d[:, 1] * (0.5 * height))
        self.views[rows] += 1

    def mean(self) -> np.ndarray:
        return self.total / np.maximum(self.views, 1)  # never seen: 0


def densify(
    model: Model,
    statistics: Statistics,
    rule: Densify,
    extent: float,
    rng: np.random.Generator,
    fits: Callable[[int], bool] = lambda _: True,
) -> np.ndarray:
    """Adds clones and the children of splits to the model. fits(n): whether memory holds n more Gaussians; if
    not, nothing is added.

    Returns (N,) bool over the Gaussians of the model, the new ones included: False for split parents, which
    the caller removes.
    """
    largest = np.exp(model.log_scales.max(axis=1))
    selected = statistics.mean() >= rule.gradient
    small = largest <= rule.small * extent
    clone, split = np.flatnonzero(selected & small), np.flatnonzero(selected & ~small)
    parents = np.concatenate([clone, np.repeat(split, rule.split_into)])
    if not len(parents) or not fits(len(parents)):
        return np.ones(model.count, bool)
    rows = {name: value[parents] for name, value in model.values.items()}
    _place_children(rows, len(clone), rule, rng)
    model.append(rows)
    stays = np.ones(model.count, bool)
    stays[split] = False
    return stays


def keep_mask(model: Model, rule: Densify, extent: float, after_reset: bool) -> np.ndarray:
    """(N,) bool: the Gaussians that 3DGS does not prune: opacity at least min_opacity and, after the first
    opacity reset, a scale of at most max_scale times the extent. The published rule on the size on the screen
    is left out, because it never applies."""
    keep = model.opacity_logits >= np.log(rule.min_opacity / (1 - rule.min_opacity))
    if after_reset:
        keep &= np.exp(model.log_scales.max(axis=1)) <= rule.max_scale * extent
    return keep


def _place_children(rows: dict[str, np.ndarray], clones: int, rule: Densify, rng: np.random.Generator):
    """Draws splits' children, all rows but the first `clones`, from their parents and shrinks them."""
    if len(rows["means"]) == clones:
        return
    children = slice(clones, None)
    scales = np.exp(rows["log_scales"][children])
    offsets = rng.standard_normal(scales.shape) * scales
    rows["means"][children] += np.einsum("nij,nj->ni", rotation_matrices(rows["quats"][children]), offsets)
    rows["log_scales"][children] -= np.log(rule.split_shrink)


def reset_opacity(model: Model):
    """Opacity reset of 3DGS: opacity becomes min(opacity, 0.01), and its moments become 0."""
    limit = np.log(RESET_OPACITY / (1 - RESET_OPACITY))
    np.minimum(model.opacity_logits, limit, out=model.values["opacity_logits"])
    model.moments["opacity_logits"][:] = 0


def lower_opacity(model: Model, rows: np.ndarray, factor: float, odds: float):
    """Lowers the opacities o of the rows (N,) bool: o becomes factor o, then its odds o / (1 - o) are
    multiplied by `odds`, both in (0, 1]. The moments of all logits become 0. With o = 1 / (1 + exp(-l)) the
    new logit is log factor - log(exp(-l) + 1 - factor) + log odds."""
    logits = model.opacity_logits.astype(np.float64)
    with np.errstate(divide="ignore"):  # log(1 - factor) of a factor of 1, which leaves a logit as it is
        lowered = np.log(factor) - np.logaddexp(-logits, np.log1p(-factor)) + np.log(odds)
    np.copyto(model.values["opacity_logits"], lowered, where=rows, casting="same_kind")
    model.moments["opacity_logits"][:] = 0
