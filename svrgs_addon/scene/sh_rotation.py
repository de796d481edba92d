"""Rotates view-dependent colours: real spherical harmonics of degree 0 to 3, also by reflections."""

from __future__ import annotations

import functools

import numpy as np

from .gaussians import SH_COEFFICIENTS

# directions at which a band is fitted; 2 * degree + 1 suffice, more keep the linear system well conditioned
SAMPLES = 64
C1 = 0.4886025119029199
C2 = (1.0925484305920792, -1.0925484305920792, 0.31539156525252005, -1.0925484305920792, 0.5462742152960396)
C3 = (
    -0.5900435899266435, 2.890611442640554, -0.4570457994644658, 0.3731763325901154,
    -0.4570457994644658, 1.445305721320277, -0.5900435899266435,
)  # fmt: skip


def band(degree: int, directions: np.ndarray) -> np.ndarray:
    """The basis functions Y of one degree (1 to 3) at unit directions (n, 3): (n, 2 * degree + 1) float64, in
    the order and signs of 3DGS."""
    x, y, z = np.asarray(directions, np.float64).T
    xx, yy, zz = x * x, y * y, z * z
    if degree == 1:
        return C1 * np.stack([-y, z, -x], 1)
    if degree == 2:
        return np.stack([x * y, y * z, 2 * zz - xx - yy, x * z, xx - yy], 1) * C2
    polynomials = (
        y * (3 * xx - yy),
        x * y * z,
        y * (4 * zz - xx - yy),
        z * (2 * zz - 3 * xx - 3 * yy),
        x * (4 * zz - xx - yy),
        z * (xx - yy),
        x * (xx - 3 * yy),
    )
    return np.stack(polynomials, 1) * C3


def band_rotation(degree: int, R: np.ndarray) -> np.ndarray:
    """The matrix D, (2 * degree + 1, 2 * degree + 1) float64, that rotates SH coefficients c of one degree by
    an orthogonal R (3, 3).

    For every direction d: Y(d) · D c = Y(Rᵀ d) · c. A rotation does not mix degrees, so a fit at enough
    directions gives D exactly.
    """
    directions = _directions()
    return np.linalg.pinv(band(degree, directions)) @ band(degree, directions @ R)


def rotate_sh(sh: np.ndarray, R: np.ndarray) -> np.ndarray:
    """SH coefficients (N, K, 3) float32 of a scene whose points move from x to R x. R (3, 3) is orthogonal
    and may mirror. Computed in float64."""
    rotated = sh.copy()
    for degree in range(1, SH_COEFFICIENTS.index(sh.shape[1]) + 1):
        columns = slice(degree**2, (degree + 1) ** 2)
        rotated[:, columns] = np.einsum(
            "ij,njc->nic", band_rotation(degree, R), sh[:, columns], optimize=True
        )
    return rotated


@functools.cache
def _directions() -> np.ndarray:
    """Evenly distributed unit vectors (SAMPLES, 3) float64 (Fibonacci sphere)."""
    i = np.arange(SAMPLES) + 0.5
    z, angle = 1 - 2 * i / SAMPLES, np.pi * (1 + 5**0.5) * i
    r = np.sqrt(1 - z * z)
    return np.stack([r * np.cos(angle), r * np.sin(angle), z], 1)
