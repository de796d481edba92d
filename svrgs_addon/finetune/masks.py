"""Masks: sampling, pruning events and the final decision (MaskGaussian section 3; SVR-GS section II-A)."""

from __future__ import annotations

import numpy as np

from ..native.rasterizer import sample_masks
from ..system.errors import SceneError
from .model import MASK, Model
from .scores import top

# added to the step numbers of pruning events, so that their random numbers differ from those of the steps
_EVENT_STREAM = 1 << 62
MIN_SHARE = 1e-3  # a run that would leave less than this share of a scene is refused


def draw(model: Model, seed: int, step: int) -> tuple[np.ndarray, np.ndarray]:
    """The masks of a step, (N,) uint8, and their straight-through slopes dM/dlogit, (N,) in the model's
    dtype.

    M_i = 1[m_i + logistic noise > 0]; the slope is y (1 - y) with y = sigmoid(m_i + noise). The noise is
    keyed by (seed, step, i).
    """
    masks, slope = sample_masks(np.ascontiguousarray(model.values[MASK], np.float32), seed, step)
    return masks, slope.astype(model.dtype, copy=False)


def ever_drawn(model: Model, seed: int, step: int, draws: int) -> np.ndarray:
    """(N,) bool: the Gaussians that appear in at least one of `draws` samples. A pruning event removes the
    others (SVR-GS section II-A)."""
    logits = np.ascontiguousarray(model.values[MASK], np.float32)
    seen = np.zeros(model.count, bool)
    for k in range(draws):
        seen |= sample_masks(logits, seed, _EVENT_STREAM + step * draws + k)[0].astype(bool)
    return seen


def most_probable(model: Model, target: int = 0, own: np.ndarray | None = None) -> np.ndarray:
    """(N,) bool: the decision at the end of mask learning, without sampling.

    Without a target, Gaussians with p > 0.5 stay. With a target, the `target` most probable ones stay (all,
    if fewer are left). own: (N,) bool, those that the target is about; None: all.
    """
    logits = model.values[MASK]
    stays = logits > 0
    if target:
        counted = slice(None) if own is None else own
        stays[counted] = top(logits[counted], target)
    return stays


def refuse_emptying(keep: np.ndarray, before: int, target: int = 0):
    """Raises SceneError if `keep` (N,) leaves none, or less than the target and MIN_SHARE of `before`."""
    left = int(keep.sum())
    if left < max(1, min(before * MIN_SHARE, target or before)):
        raise SceneError(
            f"pruning would leave {left} of {before:,} Gaussians: use a smaller lambda-f or min-contribution"
            " than now, or a target count; photographs that are black or show another scene need none"
        )
