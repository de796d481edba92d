"""Raw values of 3DGS files <-> the activated ones Blender's splats hold: scale, opacity, unit quaternion.

float32 cannot undo an exponential bit by bit, so the raw value is kept beside the activated one, and holds as long as it
still stands for it.
"""

from __future__ import annotations

import numpy as np

SAME = 2e-6  # relative difference of activated values below which the raw ones beside them hold; two machines' exp differ less


def scales(log_scales: np.ndarray) -> np.ndarray:
    """exp, float32; infinite where too large for one."""
    with np.errstate(over="ignore"):
        return np.exp(log_scales)


def opacities(opacity_logits: np.ndarray) -> np.ndarray:
    """Sigmoid, float32."""
    with np.errstate(over="ignore"):
        return 1 / (1 + np.exp(-opacity_logits))


def rotations(quats: np.ndarray) -> np.ndarray:
    """(N, 4) quaternions of length 1, float32; those without length become the identity."""
    lengths = np.sqrt(np.einsum("ij,ij->i", quats, quats, dtype=np.float64))
    with np.errstate(divide="ignore", invalid="ignore"):
        unit = (quats / lengths[:, None]).astype(np.float32)
    unit[~(lengths > 0)] = (1, 0, 0, 0)
    return unit


def raw_scales(values: np.ndarray, kept: np.ndarray | None = None) -> np.ndarray:
    """Log-scales (N, 3) float32 of scales; exactly `kept` wherever that still stands for them."""
    with np.errstate(divide="ignore", invalid="ignore"):
        return _restore(np.log(values), kept, lambda raw: _same(scales(raw), values))


def raw_opacities(values: np.ndarray, kept: np.ndarray | None = None) -> np.ndarray:
    """Opacity logits (N,) float32 of opacities; exactly `kept` wherever that still stands for them."""
    wide = values.astype(np.float64)
    with np.errstate(divide="ignore", invalid="ignore"):
        return _restore((np.log(wide) - np.log1p(-wide)).astype(np.float32), kept, lambda raw: _same(opacities(raw), values))


def raw_rotations(values: np.ndarray, kept: np.ndarray | None = None) -> np.ndarray:
    """Quaternions (N, 4) float32 of any length; exactly `kept` wherever they still stand for `values`."""
    return _restore(values, kept, lambda raw: (np.abs(rotations(raw) - values) <= SAME).all(axis=1, keepdims=True))


def _restore(computed: np.ndarray, kept: np.ndarray | None, holds) -> np.ndarray:
    return computed if kept is None else np.where(holds(kept), kept, computed)


def _same(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    with np.errstate(invalid="ignore"):
        return (a == b) | (np.abs(a - b) <= SAME * np.abs(b))
