"""Explicit repair of a scene after reading. Readers keep data as stored; callers repair, and report the counts.

An infinite value is not always damage: an opacity logit of +inf is an alpha of exactly 1 (an 8-bit 255 read back
through the logit), -inf an alpha of 0, and a log-scale of -inf a perfectly flat Gaussian. clamp_extremes makes these
finite without changing the picture; drop_nonfinite removes what has no meaning.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from ..scene import Scene

LOGIT_OF_ONE = 10.0  # alpha 0.99995: drawn like 1, since alpha is cut at 0.99, yet its gradient is not zero
MAX_ABS_LOG_SCALE = 30.0
MIN_QUAT = 1e-8  # a shorter quaternion names no rotation


def unusable(scene: Scene) -> np.ndarray:
    """(N,) bool: Gaussians that nothing can draw.

    NaN anywhere, an infinite mean, quaternion, SH coefficient or size, or a quaternion of no length.
    """
    good = ~np.isnan(scene.opacity_logits)
    good &= _rows(scene.log_scales < np.inf)  # false for NaN too
    good &= np.abs(np.ascontiguousarray(scene.quats.T)).max(axis=0) > MIN_QUAT
    for array in (scene.means, scene.quats, scene.sh.reshape(scene.count, 3 * scene.sh.shape[1])):
        good &= _rows(np.isfinite(array))
    return ~good


def _rows(flags: np.ndarray) -> np.ndarray | np.bool_:
    """flags.all(axis=1), or one True for all rows: NumPy is slow on short rows, and most scenes are sound."""
    everywhere = flags.all()
    return everywhere if everywhere else flags.all(axis=1)


def drop_nonfinite(scene: Scene) -> tuple[Scene, int]:
    """The scene without its unusable Gaussians, and how many they were."""
    bad = unusable(scene)
    count = int(bad.sum())
    return (scene.select(~bad) if count else scene), count


def clamp_extremes(scene: Scene) -> tuple[Scene, int]:
    """The scene with infinite opacity logits made ±10 and log-scales clamped to ±30, and how many Gaussians changed.

    NaN stays NaN. Finite logits stay as they are.
    """
    infinite = np.isinf(scene.opacity_logits)
    extreme = (np.abs(scene.log_scales) > MAX_ABS_LOG_SCALE).any(axis=1)
    count = int((infinite | extreme).sum())
    if not count:
        return scene, 0
    limit = np.copysign(np.float32(LOGIT_OF_ONE), scene.opacity_logits)
    return replace(
        scene,
        opacity_logits=np.where(infinite, limit, scene.opacity_logits),
        log_scales=np.clip(scene.log_scales, -MAX_ABS_LOG_SCALE, MAX_ABS_LOG_SCALE),
    ), count
