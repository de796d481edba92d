"""A scene in other coordinates: means, shapes and view-dependent colours under an affine matrix, computed in float64."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from ..errors import SceneError
from ..scene import Scene
from .rotations import quat_product, quats_of, rotation_matrices
from .sh_rotation import rotate_sh

UNIFORM = 1e-5  # relative difference of the axes' scales up to which they count as one: float32 matrices are no better
BLOCK = 65_536


def stretch(matrix: np.ndarray) -> float:
    """Largest over smallest scale of a 4x4 matrix's axes; 1 where it keeps shapes. Raises SceneError where it flattens space."""
    scales = np.linalg.svd(_linear(matrix), compute_uv=False)
    return float(scales[0] / scales[-1])


def transformed(scene: Scene, matrix: np.ndarray) -> Scene:
    """The scene with every point x at A x + t, of the affine 4x4 `matrix`; mirrorings too.

    Exact but for the view dependence of colours where A stretches axes differently (see stretch): they turn with the
    rotation nearest to A. Further attributes stay. Raises SceneError where A flattens space.
    """
    A, t = _linear(matrix), np.asarray(matrix, np.float64)[:3, 3]
    left, scales, right = np.linalg.svd(A)
    R, scale = left @ right, float(np.exp(np.log(scales).mean()))
    if scales[0] / scales[-1] - 1 <= UNIFORM:
        q = quats_of((R * np.linalg.det(R))[None])[0]  # a Gaussian is its own mirror image: -R turns it as R does
        shapes = scene.log_scales + np.log(scale), quat_product(q, scene.quats.astype(np.float64))
    else:
        shapes = _stretched(scene, A)
    return replace(
        scene,
        means=(scene.means.astype(np.float64) @ A.T + t).astype(np.float32),
        log_scales=shapes[0].astype(np.float32),
        quats=shapes[1].astype(np.float32),
        sh=rotate_sh(scene.sh, R),
    )


def _linear(matrix: np.ndarray) -> np.ndarray:
    A = np.asarray(matrix, np.float64)[:3, :3]
    if not np.isfinite(A).all() or not abs(np.linalg.det(A)) > 1e-12 * max(float(np.linalg.norm(A)), 1e-300) ** 3:
        raise SceneError("a scale of the object is zero or not finite, so its Gaussians have no shape in the world; set it to 1 first")
    return A


def _stretched(scene: Scene, A: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Log-scales and quaternions of the covariances A Σ Aᵀ: from the singular values of A R S."""
    log_scales, quats = np.empty((scene.count, 3)), np.empty((scene.count, 4))
    for start in range(0, scene.count, BLOCK):
        part = slice(start, start + BLOCK)
        logs = scene.log_scales[part].astype(np.float64)
        largest = logs.max(axis=1, keepdims=True)
        axes = A @ (rotation_matrices(scene.quats[part]) * np.exp(logs - largest)[:, None, :])
        left, sizes, _ = np.linalg.svd(axes)
        left[:, :, 2] *= np.linalg.det(left)[:, None]
        with np.errstate(divide="ignore"):
            log_scales[part] = np.log(sizes) + largest
        quats[part] = quats_of(left)
    return np.maximum(log_scales, -80), quats
