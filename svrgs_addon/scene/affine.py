"""Affine transforms of a scene: means, covariances and view-dependent colours. Computed in float64."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from ..system.errors import SceneError
from .gaussians import Scene
from .rotations import quat_product, quats_from_matrices, rotation_matrices
from .sh_rotation import rotate_sh

# scales of the axes count as equal up to this relative difference, the precision of float32 matrices
UNIFORM = 1e-5
BLOCK = 65_536  # Gaussians that are computed at a time


def stretch(matrix: np.ndarray) -> float:
    """Largest over smallest singular value of the linear part of a 4x4 matrix; 1 if it keeps shapes. Raises
    SceneError if the matrix is singular or not finite."""
    scales = np.linalg.svd(_linear(matrix), compute_uv=False)
    return float(scales[0] / scales[-1])


def transformed(scene: Scene, matrix: np.ndarray) -> Scene:
    """The scene with every point x moved to A x + t; A and t are parts of the affine 4x4 `matrix`, which may
    mirror.

    Means and covariances A Σ Aᵀ are exact. View-dependent colours are exact if A scales all axes alike (see
    stretch); else they are rotated with the rotation nearest to A. Further attributes do not change; with the
    identity nothing does. Raises SceneError if A is singular or not finite.
    """
    if np.array_equal(matrix, np.eye(4)):
        return scene
    A, t = _linear(matrix), np.asarray(matrix, np.float64)[:3, 3]
    left, scales, right = np.linalg.svd(A)
    R, scale = left @ right, float(np.exp(np.log(scales).mean()))
    if scales[0] / scales[-1] - 1 <= UNIFORM:
        # a Gaussian is its own mirror image, so -R rotates it as R does
        q = quats_from_matrices((R * np.linalg.det(R))[None])[0]
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


def scaled(scene: Scene, factor: float) -> Scene:
    """The scene with all lengths multiplied by a factor above 0, around the origin."""
    if factor == 1:
        return scene
    return replace(
        scene,
        means=(scene.means * factor).astype(np.float32),
        log_scales=(scene.log_scales + np.log(factor)).astype(np.float32),
    )


def _linear(matrix: np.ndarray) -> np.ndarray:
    """The linear part A (3, 3) float64 of a 4x4 matrix. Raises SceneError if it is singular or not finite."""
    A = np.asarray(matrix, np.float64)[:3, :3]
    smallest = 1e-12 * max(float(np.linalg.norm(A)), 1e-300) ** 3
    if not np.isfinite(A).all() or not abs(np.linalg.det(A)) > smallest:
        raise SceneError(
            "a scale of the object is zero or not finite, so its Gaussians have no shape in the world; set it"
            " to 1 first"
        )
    return A


def _stretched(scene: Scene, A: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Log-scales (N, 3) and quaternions (N, 4), float64, of the covariances A Σ Aᵀ. With Σ = R S S Rᵀ, they
    are the singular values and the left singular vectors of A R S."""
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
        quats[part] = quats_from_matrices(left)
    return np.maximum(log_scales, -80), quats
