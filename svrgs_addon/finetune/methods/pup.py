"""PUP 3D-GS (arXiv 2406.10219): ranks by sensitivity, how much the views change when a Gaussian moves or
changes its size. One cut; published with two.

The score is log det H of a 6x6 matrix per Gaussian:

    H = sum over views, pixels, channels of g g^T,    g = dC/d(mean, log-scale)

The colour C of a pixel depends on these six values through alpha alone; the change of the view-dependent
colour with position is left out. alpha depends on them through the centre mu and the covariance Sigma on the
screen. With w = (u, v) = L (pixel - mu), L^T L k^2 = Sigma^-1 and k^2 = 2 ln 2:

    d ln alpha = k^2 w^T L dmu + k^4/2 w^T (L dSigma L^T) w = t^T J,    t = (u, v, uu, uv, vv)

So one view adds J^T S J to H, where S is the sum over its pixels of W t t^T (W: native.Rasterizer.moments).
"""

from __future__ import annotations

import numpy as np

from ...native.library import thresholds
from ...native.rasterizer import MOMENTS
from ...scene.camera import Camera
from ...scene.gaussians import Scene
from ...scene.rotations import rotation_matrices
from ..viewed_scene import ViewedScene
from .ranked import Ranked

REDUCTION = 4  # views are rendered at a quarter of their size, as published
K2 = 2 * np.log(2)
ROWS = 32_768  # Gaussians that are worked on at a time
_UPPER = np.triu_indices(6)
# S[i, j] is the moment of t_i t_j.
_T = ("u", "v", "uu", "uv", "vv")
_S = np.array([[MOMENTS.index("".join(sorted(a + b))) for b in _T] for a in _T])


def log_determinants(viewed: ViewedScene) -> np.ndarray:
    """log det H of each Gaussian, (N,) float64. -inf if H is singular: no pixel sees the Gaussian, or only
    pixels on one line do."""
    scene, rasterizer = viewed.scene, viewed.rasterizer
    sums = np.zeros((scene.count, len(_UPPER[0])))
    for view, _ in viewed.reduced(REDUCTION).rendered():
        ids, moments = rasterizer.visible(), rasterizer.moments()
        for start in range(0, len(ids), ROWS):
            rows = ids[start : start + ROWS]
            sums[rows] += _view_part(moments[start : start + ROWS], jacobians(scene, view, rows))
    result = np.empty(scene.count)
    for start in range(0, scene.count, ROWS):
        part = slice(start, start + ROWS)
        result[part] = _log_det(sums[part])
    return result


def _view_part(moments: np.ndarray, J: np.ndarray) -> np.ndarray:
    """What a view adds to H: the upper triangle of J^T S J, (V, 21). moments (V, 12), J (V, 5, 6)."""
    return (J.swapaxes(1, 2) @ moments[:, _S] @ J)[:, *_UPPER]


def _log_det(upper: np.ndarray) -> np.ndarray:
    H = np.zeros((len(upper), 6, 6))
    H[:, *_UPPER] = H[:, _UPPER[1], _UPPER[0]] = upper
    # H is scaled to a unit diagonal, because positions and log-scales differ in units
    scale = np.sqrt(np.maximum(np.einsum("nii->ni", H), 0))
    seen = (scale > 0).all(axis=1)
    scale = np.where(seen[:, None], scale, 1.0)
    sign, log_det = np.linalg.slogdet(H / (scale[:, :, None] * scale[:, None, :]))
    return np.where(seen & (sign > 0), log_det + 2 * np.log(scale).sum(axis=1), -np.inf)


def jacobians(scene: Scene, camera: Camera, ids: np.ndarray) -> np.ndarray:
    """J of the Gaussians `ids`, (V, 5, 6) float64: d ln alpha = t^T J d(mean, log-scale) at every pixel."""
    W, K = camera.viewmat[:3, :3], camera.K
    points = scene.means[ids].astype(np.float64) @ W.T + camera.viewmat[:3, 3]
    scales = np.exp(scene.log_scales[ids].astype(np.float64))
    axes = W @ rotation_matrices(scene.quats[ids].astype(np.float64)) * scales[:, None, :]  # (V, 3, 3)
    P, dP = screen_jacobian(points, K, camera.width, camera.height)
    half = P @ axes  # (V, 2, 3): half axes on the screen
    L = whitening(half @ half.swapaxes(1, 2) + thresholds().blur * np.eye(2))
    white = L @ half
    d_cov = np.empty((len(ids), 6, 2, 2))  # L dSigma L^T
    for k in range(3):
        turned = white @ (L @ dP[:, k] @ axes).swapaxes(1, 2)  # derivative along axis k of the camera
        d_cov[:, k] = turned + turned.swapaxes(1, 2)
        d_cov[:, 3 + k] = 2 * white[:, :, k, None] * white[:, None, :, k]
    J = np.zeros((len(ids), 5, 6))
    J[:, :2, :3] = K2 * L @ centre_jacobian(points, K)
    J[:, 2:] = K2**2 / 2 * np.stack([d_cov[..., 0, 0], 2 * d_cov[..., 0, 1], d_cov[..., 1, 1]], axis=1)
    J[:, :, :3] = J[:, :, :3] @ W  # from the camera's axes to the world's
    return J


def whitening(cov: np.ndarray) -> np.ndarray:
    """L (V, 2, 2), upper triangular, with L^T L = cov^-1 / k^2. cov (V, 2, 2)."""
    xx, xy, yy = cov[:, 0, 0], cov[:, 0, 1], cov[:, 1, 1]
    L = np.zeros_like(cov)
    L[:, 0, 0] = np.sqrt(yy / (K2 * (xx * yy - xy * xy)))
    L[:, 0, 1] = -L[:, 0, 0] * xy / yy
    L[:, 1, 1] = 1 / np.sqrt(K2 * yy)
    return L


def centre_jacobian(points: np.ndarray, K: np.ndarray) -> np.ndarray:
    """d(pixel)/d(camera point), (V, 2, 3), at points (V, 3) in camera coordinates."""
    x, y, z = points.T
    zero, fx, fy = np.zeros_like(z), K[0, 0], K[1, 1]
    rows = [[fx / z, zero, -fx * x / z**2], [zero, fy / z, -fy * y / z**2]]
    return np.stack([np.stack(row, 1) for row in rows], 1)


def screen_jacobian(
    points: np.ndarray, K: np.ndarray, width: int, height: int
) -> tuple[np.ndarray, np.ndarray]:
    """The Jacobian P (V, 2, 3) that projects covariances to the screen, and dP/d(camera point) (V, 3, 2, 3).
    points (V, 3): camera coordinates.

    As in the rasterizer and in gsplat, x/z and y/z are clamped to the true image borders widened by the
    frustum margin.
    """
    focal, principal, size, z = K.diagonal()[:2], K[:2, 2], np.array([width, height]), points[:, 2:]
    margin = thresholds().frustum_margin * size / (2 * focal)
    slope = points[:, :2] / z
    clamped = np.clip(slope, -principal / focal - margin, (size - principal) / focal + margin)
    free = slope == clamped
    P, dP = np.zeros((len(points), 2, 3)), np.zeros((len(points), 3, 2, 3))
    for r in range(2):
        f = focal[r] / z[:, 0]
        P[:, r, r], P[:, r, 2] = f, -f * clamped[:, r]
        dP[:, 2, r, r] = -f / z[:, 0]
        dP[:, 2, r, 2] = f * (clamped[:, r] + free[:, r] * slope[:, r]) / z[:, 0]
        dP[:, r, r, 2] = -f * free[:, r] / z[:, 0]
    return P, dP


METHODS = (
    Ranked(
        "pup",
        "removes, in one cut, the Gaussians whose position and size change the photographs least",
        17,
        "PUP 3D-GS",
        source="PUP 3D-GS, arXiv 2406.10219",
        ranking=log_determinants,
    ),
)
