"""Converts raw values of 3DGS files to the activated values in Blender's splats and back: scale, opacity,
unit quaternion.

float32 cannot invert an exponential exactly. So Blender's splats also hold the raw value. It is used again
while its activation still equals the activated value, up to TOLERANCE; after an edit, or without a raw value,
the activated value is inverted.
"""

from __future__ import annotations

import numpy as np

# opacity 0.99995: rendered like 1, because alpha is clamped at 0.99, but its gradient is not zero
LOGIT_OF_ONE = 10.0
TOLERANCE = 2e-6  # relative difference of activated values; exp differs less between two machines


def scales(log_scales: np.ndarray) -> np.ndarray:
    """Scales exp(log_scales), float32, in units of length of the scene; infinite beyond float32."""
    with np.errstate(over="ignore"):
        return np.exp(log_scales)


def opacities(opacity_logits: np.ndarray) -> np.ndarray:
    """Opacities sigmoid(opacity_logits) in 0..1, float32."""
    with np.errstate(over="ignore"):
        return 1 / (1 + np.exp(-opacity_logits))


def rotations(quats: np.ndarray) -> np.ndarray:
    """Unit quaternions (N, 4) float32, w x y z; quaternions of length 0 become the identity."""
    lengths = np.sqrt(np.einsum("ij,ij->i", quats, quats, dtype=np.float64))
    with np.errstate(divide="ignore", invalid="ignore"):
        unit = (quats / lengths[:, None]).astype(np.float32)
    unit[~(lengths > 0)] = (1, 0, 0, 0)
    return unit


def raw_scales(values: np.ndarray, kept: np.ndarray | None = None) -> np.ndarray:
    """Log-scales (N, 3) float32 of scales; `kept`, (N, 3) or None, where exp(kept) still equals the scale."""
    with np.errstate(divide="ignore", invalid="ignore"):
        return _restore(np.log(values), kept, lambda raw: _same(scales(raw), values))


def raw_opacities(values: np.ndarray, kept: np.ndarray | None = None) -> np.ndarray:
    """Opacity logits (N,) float32 of opacities, finite also of 0 and 1; equal to `kept` where sigmoid(kept)
    still equals the opacity. kept: (N,) or None."""
    wide = values.astype(np.float64)
    with np.errstate(divide="ignore", invalid="ignore"):
        logits = (np.log(wide) - np.log1p(-wide)).astype(np.float32)
        logits = np.where(np.isinf(logits), np.copysign(np.float32(LOGIT_OF_ONE), logits), logits)
        return _restore(logits, kept, lambda raw: _same(opacities(raw), values))


def raw_rotations(values: np.ndarray, kept: np.ndarray | None = None) -> np.ndarray:
    """Quaternions (N, 4) float32 of any length; `kept` where kept / |kept| still equals the row."""
    return _restore(
        values, kept, lambda raw: (np.abs(rotations(raw) - values) <= TOLERANCE).all(axis=1, keepdims=True)
    )


def _restore(computed: np.ndarray, kept: np.ndarray | None, holds) -> np.ndarray:
    """`kept` where holds(kept), else `computed`."""
    return computed if kept is None else np.where(holds(kept), kept, computed)


def _same(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """Whether values are equal up to TOLERANCE, also if both are infinite; bool."""
    with np.errstate(invalid="ignore"):
        return (a == b) | (np.abs(a - b) <= TOLERANCE * np.abs(b))
