"""Gaussians as a graphics card draws them: one blended quad each, in order of depth."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from ..blender import activation
from ..camera import Camera
from ..geometry.rotations import rotation_matrices
from ..geometry.sh_rotation import band
from ..scene import SH_C0, Scene
from .color_maps import colored

BLOCK = 65_536
SEED = 1
TOP = 99.0  # percentile of the numbers that gets the brightest colour


@dataclass(frozen=True)
class Quads:
    """Some Gaussians of a scene in random order: any first part of them stands for the whole."""

    rows: np.ndarray  # (n,) int64: the row of the scene each comes from
    means: np.ndarray  # (n, 3) float32
    geometry: np.ndarray  # (n, 3, 4) float32: mean, opacity; covariance xx xy xz, 0; yy yz zz, 0


def quads(scene: Scene, count: int) -> Quads:
    """At most `count` Gaussians."""
    rows = np.random.default_rng(SEED).permutation(scene.count)[:count]
    geometry = np.zeros((len(rows), 3, 4), np.float32)
    for start in range(0, len(rows), BLOCK):
        part = rows[start : start + BLOCK]
        axes = rotation_matrices(scene.quats[part]) * np.exp(scene.log_scales[part].astype(np.float64))[:, None, :]
        S = axes @ axes.swapaxes(1, 2)
        block = geometry[start : start + BLOCK]
        block[:, 0, :3], block[:, 0, 3] = scene.means[part], activation.opacities(scene.opacity_logits[part])
        block[:, 1, :3], block[:, 2, :3] = S[:, 0], np.stack([S[:, 1, 1], S[:, 1, 2], S[:, 2, 2]], 1)
    return Quads(rows, np.ascontiguousarray(scene.means[rows]), geometry)


def painted(scene: Scene, values: list[np.ndarray | None]) -> Scene:
    """The scene in colours of numbers, given part by part (N_i,); as it is where a part has none."""
    known = [part for part in values if part is not None]
    if len(known) < len(values):
        return scene
    joined = np.concatenate(known)
    return recolored(scene, colored(joined, float(np.percentile(joined, TOP)) if len(joined) else 1.0))


def recolored(scene: Scene, rgb: np.ndarray) -> Scene:
    """The scene with colours (N, 3), display sRGB in [0, 1], that do not depend on the direction."""
    return replace(scene, sh=np.ascontiguousarray(((rgb - 0.5) / SH_C0)[:, None], np.float32))


def colors(scene: Scene, rows: np.ndarray, camera: Camera) -> np.ndarray:
    """(N, 3) float32 display colours of these rows as a camera in the scene's coordinates sees them."""
    result = np.empty((len(rows), 3), np.float32)
    for start in range(0, len(rows), BLOCK):
        part = rows[start : start + BLOCK]
        sh = scene.sh[part]
        directions = camera.directions(scene.means[part])
        color = 0.5 + SH_C0 * sh[:, 0]
        for degree in range(1, scene.sh_degree + 1):
            basis = band(degree, directions).astype(np.float32)
            color += np.einsum("nk,nkc->nc", basis, sh[:, degree**2 : (degree + 1) ** 2])
        result[start : start + BLOCK] = np.maximum(color, 0)
    return result
