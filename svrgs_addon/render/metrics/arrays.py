"""The check of two images that all metrics make."""

from __future__ import annotations

import numpy as np

from ...system.errors import SceneError


def image_pair(a: np.ndarray, b: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Both images as contiguous float32 (H, W, 3). Raises SceneError if their shapes differ or a value is not
    finite."""
    a, b = np.ascontiguousarray(a, np.float32), np.ascontiguousarray(b, np.float32)
    if a.shape != b.shape or a.ndim != 3 or a.shape[2] != 3 or a.size == 0:
        raise SceneError(f"cannot compare images of shapes {a.shape} and {b.shape}; both must be (H, W, 3)")
    if not (np.isfinite(a).all() and np.isfinite(b).all()):
        raise SceneError("cannot compare images that hold NaN or infinite values")
    return a, b
