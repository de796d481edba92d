"""Learned existence: sampling, pruning events, the final decision (MaskGaussian, as SVR-GS uses it)."""

from __future__ import annotations

import numpy as np

from ..errors import SceneError
from ..native import sample_masks
from .model import MASK, Model
from .scores import top

_EVENT_STREAM = 1 << 62  # keeps an event's draws apart from those of the steps
MIN_SHARE = 1e-3  # a run that would leave less than this share of a scene is refused


def draw(model: Model, seed: int, step: int) -> tuple[np.ndarray, np.ndarray]:
    """This step's masks (N,) uint8 and straight-through slopes (N,) in the model's dtype."""
    masks, slope = sample_masks(np.ascontiguousarray(model.values[MASK], np.float32), seed, step)
    return masks, slope.astype(model.dtype, copy=False)


def dropout_masks(count: int, share: float, seed: int, step: int) -> np.ndarray:
    """This step's masks (N,) uint8, each 0 with probability `share`. Nothing is learned about them."""
    return (np.random.default_rng([seed, 3, step]).random(count, np.float32) >= share).astype(np.uint8)


def ever_drawn(model: Model, seed: int, step: int, draws: int) -> np.ndarray:
    """(N,) bool: existed in at least one of `draws` samples (paper section II-A). False: to be pruned."""
    logits = np.ascontiguousarray(model.values[MASK], np.float32)
    seen = np.zeros(model.count, bool)
    for k in range(draws):
        seen |= sample_masks(logits, seed, _EVENT_STREAM + step * draws + k)[0].astype(bool)
    return seen


def most_probable(model: Model, target: int = 0) -> np.ndarray:
    """(N,) bool, the deterministic end of mask learning: p > 0.5, or the `target` most probable (all, where fewer are left)."""
    logits = model.values[MASK]
    return top(logits, target) if target else logits > 0


def refuse_emptying(keep: np.ndarray, before: int, target: int = 0):
    """Raises SceneError where `keep` would leave (next to) nothing of a scene of `before` Gaussians, and less than the `target` asked for."""
    left = int(keep.sum())
    if left < max(1, min(before * MIN_SHARE, target or before)):
        raise SceneError(f"pruning would leave {left} of {before:,} Gaussians: use a smaller lambda-f or min-contribution, or a target count")
