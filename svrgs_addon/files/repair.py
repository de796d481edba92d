"""Repair of a scene after reading. Readers return values as stored; callers repair the scene and report the
counts.

Some infinite values have a meaning: an opacity logit of +inf is an opacity of exactly 1 (an 8-bit 255 that
was converted to a logit), -inf is an opacity of 0, and a log-scale of -inf is a perfectly flat Gaussian.
clamp_extremes makes these values finite without changing the picture. drop_nonfinite removes Gaussians whose
values have no meaning. bake_filter makes a file of Mip-Splatting an ordinary one.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from ..scene.activation import LOGIT_OF_ONE
from ..scene.gaussians import Scene

MAX_ABS_LOGIT = 1e6  # beyond, arithmetic on logits may overflow; no picture shows a difference
MAX_ABS_LOG_SCALE = 30.0
FILTER = "filter_3D"  # column of Mip-Splatting: standard deviation of a filter on each Gaussian
MIN_QUAT = 1e-8  # a quaternion without a component above this defines no rotation


def bake_filter(scene: Scene) -> tuple[Scene, bool]:
    """Bakes the 3D smoothing filter of Mip-Splatting (arXiv 2311.16493), the column filter_3D f, into scales
    s and opacities o:

        s' = sqrt(s² + f²) on each axis;    o' = o s_x s_y s_z / (s'_x s'_y s'_z)

    Returns the scene without the column, and whether it had one. f has the unit of the scales; NaN makes a
    Gaussian unusable.
    """
    if FILTER not in scene.attributes:
        return scene, False
    attributes = {name: column for name, column in scene.attributes.items() if name != FILTER}
    log_scales, logits = scene.log_scales.astype(np.float64), scene.opacity_logits.astype(np.float64)
    with np.errstate(divide="ignore", over="ignore", invalid="ignore"):  # infinite values are repaired later
        log_filter = np.log(np.abs(scene.attributes[FILTER].astype(np.float64)))[:, None]
        baked = np.logaddexp(2 * log_scales, 2 * log_filter) / 2
        log_opacity = -np.logaddexp(0, -logits) + (log_scales - baked).sum(axis=1)
        logits = log_opacity - np.log(-np.expm1(log_opacity))
    order = tuple(name for name in scene.property_order if name != FILTER)
    baked, logits = baked.astype(scene.log_scales.dtype), logits.astype(scene.opacity_logits.dtype)
    return replace(
        scene, log_scales=baked, opacity_logits=logits, attributes=attributes, property_order=order
    ), True


def unusable(scene: Scene) -> np.ndarray:
    """Marks the Gaussians that cannot be rendered, (N,) bool.

    These have a NaN, an infinite mean, quaternion or SH coefficient, a log-scale of +inf, or a quaternion of
    length 0.
    """
    good = ~np.isnan(scene.opacity_logits)
    good &= _all_in_row(scene.log_scales < np.inf)  # false for NaN too
    good &= np.abs(np.ascontiguousarray(scene.quats.T)).max(axis=0) > MIN_QUAT
    for array in (scene.means, scene.quats, scene.sh.reshape(scene.count, 3 * scene.sh.shape[1])):
        good &= _all_in_row(np.isfinite(array))
    return ~good


def _all_in_row(flags: np.ndarray) -> np.ndarray | np.bool_:
    """flags.all(axis=1), or a single True if all are true: NumPy is slow on short rows, and most scenes have
    no bad values."""
    everywhere = flags.all()
    return everywhere if everywhere else flags.all(axis=1)


def drop_nonfinite(scene: Scene) -> tuple[Scene, int]:
    """Returns the scene without its unusable Gaussians, and their number."""
    bad = unusable(scene)
    count = int(bad.sum())
    return (scene.select(~bad) if count else scene), count


def clamp_extremes(scene: Scene) -> tuple[Scene, int]:
    """Replaces opacity logits beyond ±1e6 by ±10 and clamps log-scales to ±30; NaN stays NaN. Returns the
    scene and the number of changed Gaussians."""
    infinite = np.abs(scene.opacity_logits) > MAX_ABS_LOGIT
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
