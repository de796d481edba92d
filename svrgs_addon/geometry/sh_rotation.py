"""Turning view-dependent colours: real spherical harmonics of degree 0 to 3 under rotations and mirrorings."""

from __future__ import annotations

import functools

import numpy as np

from ..scene import SH_COEFFICIENTS

SAMPLES = 64  # directions that fix a band; 2 * degree + 1 would do, more keep the system well conditioned
C1 = 0.4886025119029199
C2 = (1.0925484305920792, -1.0925484305920792, 0.31539156525252005, -1.0925484305920792, 0.5462742152960396)
C3 = (-0.5900435899266435, 2.890611442640554, -0.4570457994644658, 0.3731763325901154, -0.4570457994644658, 1.445305721320277, -0.5900435899266435)


def band(degree: int, directions: np.ndarray) -> np.ndarray:
    """The 2 * degree + 1 basis functions of one degree (1 to 3), in 3DGS's order and signs, at (n, 3) unit directions; (n, 2 * degree + 1) float64."""
    x, y, z = np.asarray(directions, np.float64).T
    xx, yy, zz = x * x, y * y, z * z
    if degree == 1:
        return C1 * np.stack([-y, z, -x], 1)
    if degree == 2:
        return np.stack([x * y, y * z, 2 * zz - xx - yy, x * z, xx - yy], 1) * C2
    polynomials = (
        y * (3 * xx - yy), x * y * z, y * (4 * zz - xx - yy), z * (2 * zz - 3 * xx - 3 * yy), x * (4 * zz - xx - yy), z * (xx - yy), x * (xx - 3 * yy),
    )  # fmt: skip
    return np.stack(polynomials, 1) * C3


def band_rotation(degree: int, R: np.ndarray) -> np.ndarray:
    """D (2 * degree + 1 square, float64) with Y(d) · D c = Y(Rᵀ d) · c for every direction d: the band turned with R (3, 3), orthogonal.

    Rotated functions stay within their band, so matching them at enough directions gives D exactly.
    """
    directions = _directions()
    return np.linalg.pinv(band(degree, directions)) @ band(degree, directions @ R)


def rotate_sh(sh: np.ndarray, R: np.ndarray) -> np.ndarray:
    """sh (N, K, 3) float32 of a scene whose points move from x to R x; computed in float64. R (3, 3): orthogonal, mirrorings too."""
    rotated = sh.copy()
    for degree in range(1, SH_COEFFICIENTS.index(sh.shape[1]) + 1):
        columns = slice(degree**2, (degree + 1) ** 2)
        rotated[:, columns] = np.einsum("ij,njc->nic", band_rotation(degree, R), sh[:, columns], optimize=True)
    return rotated


@functools.cache
def _directions() -> np.ndarray:
    """Evenly spread unit vectors (Fibonacci), (SAMPLES, 3)."""
    i = np.arange(SAMPLES) + 0.5
    z, angle = 1 - 2 * i / SAMPLES, np.pi * (1 + 5**0.5) * i
    r = np.sqrt(1 - z * z)
    return np.stack([r * np.cos(angle), r * np.sin(angle), z], 1)
