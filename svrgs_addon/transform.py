"""A scene in other coordinates: means, shapes and view-dependent colours under an affine matrix, computed in float64."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from .errors import SceneError
from .scene import Scene
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
        shapes = scene.log_scales + np.log(scale), _product(q, scene.quats.astype(np.float64))
    else:
        shapes = _stretched(scene, A)
    return replace(
        scene,
        means=(scene.means.astype(np.float64) @ A.T + t).astype(np.float32),
        log_scales=shapes[0].astype(np.float32),
        quats=shapes[1].astype(np.float32),
        sh=rotate_sh(scene.sh, R),
    )


def rotation_matrices(quats: np.ndarray) -> np.ndarray:
    """(N, 3, 3) float64 of quaternions (N, 4) w x y z of any length > 0."""
    w, x, y, z = (quats.astype(np.float64) / np.linalg.norm(quats.astype(np.float64), axis=1, keepdims=True)).T
    rows = (
        1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y),
        2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x),
        2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y),
    )  # fmt: skip
    return np.stack(rows, 1).reshape(-1, 3, 3)


def quats_of(R: np.ndarray) -> np.ndarray:
    """(N, 4) float64 unit quaternions w x y z of rotation matrices (N, 3, 3)."""
    m = np.moveaxis(R, 0, -1)
    t = np.stack([m[0, 0] + m[1, 1] + m[2, 2], m[0, 0] - m[1, 1] - m[2, 2], m[1, 1] - m[0, 0] - m[2, 2], m[2, 2] - m[0, 0] - m[1, 1]])
    a, b, c = m[2, 1] - m[1, 2], m[0, 2] - m[2, 0], m[1, 0] - m[0, 1]
    d, e, f = m[1, 0] + m[0, 1], m[0, 2] + m[2, 0], m[2, 1] + m[1, 2]
    candidates = np.stack([np.stack([t[0] + 1, a, b, c]), np.stack([a, t[1] + 1, d, e]), np.stack([b, d, t[2] + 1, f]), np.stack([c, e, f, t[3] + 1])])
    best = candidates[t.argmax(axis=0), :, np.arange(R.shape[0])]  # the one without cancellation
    return best / np.linalg.norm(best, axis=1, keepdims=True)


def _linear(matrix: np.ndarray) -> np.ndarray:
    A = np.asarray(matrix, np.float64)[:3, :3]
    if not np.isfinite(A).all() or not abs(np.linalg.det(A)) > 1e-12 * max(np.linalg.norm(A), 1e-300) ** 3:
        raise SceneError("a scale of the object is zero or not finite, so its Gaussians have no shape in the world; set it to 1 first")
    return A


def _product(p: np.ndarray, q: np.ndarray) -> np.ndarray:
    """Quaternion product of p (4,) and each of q (N, 4)."""
    w, v = p[0], p[1:]
    return np.column_stack([w * q[:, 0] - q[:, 1:] @ v, w * q[:, 1:] + q[:, :1] * v + np.cross(v, q[:, 1:])])


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
