"""Rotations as quaternions (w x y z) and as matrices. Computed in float64."""

from __future__ import annotations

import numpy as np

MAX_ROTATION_ERROR = 1e-3  # largest entry of |Rᵀ R - I|


def rotation_matrices(quats: np.ndarray) -> np.ndarray:
    """Rotation matrices (N, 3, 3) float64 of quaternions (N, 4), w x y z, of any length > 0."""
    quats = quats.astype(np.float64)
    w, x, y, z = (quats / np.linalg.norm(quats, axis=1, keepdims=True)).T
    rows = (
        1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y),
        2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x),
        2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y),
    )  # fmt: skip
    return np.stack(rows, 1).reshape(-1, 3, 3)


def rotated(quats: np.ndarray, vectors: np.ndarray) -> np.ndarray:
    """The vectors (N, 3), each turned by its quaternion (N, 4), w x y z, of any length > 0. In the dtype of
    the inputs."""
    (w, x, y, z), (a, b, c) = quats.T, vectors.T
    length = np.sqrt(w * w + x * x + y * y + z * z)
    w, x, y, z = w / length, x / length, y / length, z / length
    # t = 2 (x, y, z) cross v;  v + w t + (x, y, z) cross t
    p, q, r = 2 * (y * c - z * b), 2 * (z * a - x * c), 2 * (x * b - y * a)
    return np.stack([a + w * p + y * r - z * q, b + w * q + z * p - x * r, c + w * r + x * q - y * p], axis=1)


def quats_from_matrices(R: np.ndarray) -> np.ndarray:
    """Unit quaternions (N, 4) float64, w x y z, of rotation matrices (N, 3, 3)."""
    m = np.moveaxis(R, 0, -1)
    x, y, z = m[0, 0], m[1, 1], m[2, 2]
    t = np.stack([x + y + z, x - y - z, y - x - z, z - x - y])
    a, b, c = m[2, 1] - m[1, 2], m[0, 2] - m[2, 0], m[1, 0] - m[0, 1]
    d, e, f = m[1, 0] + m[0, 1], m[0, 2] + m[2, 0], m[2, 1] + m[1, 2]
    rows = [t[0] + 1, a, b, c], [a, t[1] + 1, d, e], [b, d, t[2] + 1, f], [c, e, f, t[3] + 1]
    candidates = np.stack([np.stack(row) for row in rows])
    # the numerically stable one of four equivalent formulas
    best = candidates[t.argmax(axis=0), :, np.arange(R.shape[0])]
    return best / np.linalg.norm(best, axis=1, keepdims=True)


def quat_product(p: np.ndarray, q: np.ndarray) -> np.ndarray:
    """Quaternion products (N, 4) of p (4,) with each row of q (N, 4): the rotation q, then p."""
    w, v = p[0], p[1:]
    return np.column_stack([w * q[:, 0] - q[:, 1:] @ v, w * q[:, 1:] + q[:, :1] * v + np.cross(v, q[:, 1:])])


def is_rotation(R: np.ndarray) -> bool:
    """Whether (3, 3) is a rotation as far as rounded numbers tell."""
    return bool(
        np.abs(R).max() < 2
        and np.abs(R.T @ R - np.eye(3)).max() < MAX_ROTATION_ERROR
        and np.linalg.det(R) >= 0
    )
