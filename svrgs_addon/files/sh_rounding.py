"""Rounds spherical harmonics to what a format can store, by the error that this causes in pictures.

Coefficients are rounded from the last one to the first. Each takes up what those before it have changed in
the directions from which the Gaussian is seen: the nearest plane algorithm of Babai, as GPTQ (arXiv
2210.17323) rounds weights. Coefficient 0, the colour, comes last: it has the finest steps. A Gaussian that is
not seen is rounded as usual.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from ..scene.gaussians import SH_C0, SH_COEFFICIENTS, Scene
from ..scene.sh_rotation import band
from .palette import solved

BLOCK = 1 << 8  # Gaussians whose directions are in memory together
PART = 1 << 12  # Gaussians whose moments are in memory together
ELSEWHERE = 0.1  # weight of all directions together; those from which a Gaussian is seen have 1


@dataclass(frozen=True)
class SeenFrom:
    """From where Gaussians are seen. positions: (V, 3) float32, camera centres in the coordinates of the
    scene. weights: (V, N) float16, how much each view shows of each Gaussian: its sum of alpha T over
    pixels."""

    positions: np.ndarray
    weights: np.ndarray

    def select(self, rows: np.ndarray | slice) -> SeenFrom:
        return SeenFrom(self.positions, self.weights[:, rows])

    def moments(self, means: np.ndarray, coefficients: int) -> np.ndarray:
        """(N, K, K) float32: the weighted mean of Y Yᵀ over the directions from which Gaussians at means
        (N, 3) are seen, plus ELSEWHERE times that over all directions."""
        found = np.empty((len(means), coefficients, coefficients), np.float32)
        for start in range(0, len(means), BLOCK):
            block = slice(start, start + BLOCK)
            weights = self.weights[:, block].T.astype(np.float32)
            weights /= np.maximum(weights.sum(axis=1, keepdims=True), np.float32(1e-30))
            offsets = means[block, None] - self.positions
            Y = basis(offsets.reshape(-1, 3), coefficients).reshape(*weights.shape, coefficients)
            Y *= np.sqrt(weights)[:, :, None]
            found[block] = Y.swapaxes(1, 2) @ Y
        return found + np.eye(coefficients, dtype=np.float32) * (ELSEWHERE * SH_C0**2)


def higher_factors(moments: np.ndarray) -> np.ndarray:
    """(N, K-1, K-1) float32: F, so that |F e|^2 is the squared error in a picture if all coefficients but the
    first one change by e, and the first one changes so that the error is least (Schur complement).
    moments: (N, K, K), see SeenFrom."""
    across = moments[:, 1:, 0] / np.sqrt(moments[:, :1, 0])
    left = moments[:, 1:, 1:] - across[:, :, None] * across[:, None]
    return np.linalg.cholesky(left).swapaxes(1, 2)


def without_bands(scene: Scene, degree: int, seen: SeenFrom | None = None) -> Scene:
    """The scene with SH up to this degree, sh (N, (degree + 1)^2, 3). With seen, those that stay (s) are
    fitted to what all showed in the directions that are seen: s + M_ss^-1 M_sh h, with the higher ones h and
    the moments M of SeenFrom, has the least squared error. Without, the higher ones are cut."""
    most, keep = scene.sh.shape[1], SH_COEFFICIENTS[degree]
    if most <= keep:
        return scene
    sh = scene.sh[:, :keep].copy()
    if seen is None:
        return replace(scene, sh=sh)
    for start in range(0, scene.count, PART):
        some = slice(start, start + PART)
        moments = seen.select(some).moments(scene.means[some], most)
        sh[some] += solved(moments[:, :keep, :keep], moments[:, :keep, keep:] @ scene.sh[some, keep:])
    return replace(scene, sh=sh)


def basis(offsets: np.ndarray, coefficients: int) -> np.ndarray:
    """(N, K) float32: the first K basis functions of 3DGS in the directions of offsets (N, 3)."""
    lengths = np.linalg.norm(offsets, axis=1, keepdims=True)
    directions = offsets / np.maximum(lengths, np.float32(1e-30))
    bands = [band(degree, directions) for degree in range(1, round(coefficients**0.5))]
    first = np.full((len(offsets), 1), SH_C0)
    return np.concatenate([first, *bands], axis=1).astype(np.float32)


def rounded(
    sh: np.ndarray, moments: np.ndarray, stored: Callable[[int, np.ndarray], np.ndarray]
) -> np.ndarray:
    """SH (N, K, 3) float32 in values that are stored. moments: (N, K, K), see SeenFrom. stored(k, values):
    what the file holds of values (N, 3) of coefficient k."""
    found, error = np.empty_like(sh), np.zeros_like(sh)
    factors = np.linalg.cholesky(moments)
    for k in reversed(range(sh.shape[1])):
        # the least error, as those before k are still free: row k of Lᵀ e is 0
        caused = np.einsum("nj,njc->nc", factors[:, k + 1 :, k], error[:, k + 1 :])
        found[:, k] = stored(k, sh[:, k] - caused / factors[:, k, k, None])
        error[:, k] = found[:, k] - sh[:, k]
    return found
