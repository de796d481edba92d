"""Gaussians as quads for the graphics card: one blended quad per Gaussian, sorted by depth.

The Solid and Material Preview modes of Blender's viewport draw some of the Gaussians in this way while a view
moves. When it stops, the exact picture of the native renderer replaces them.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from ..scene import activation
from ..scene.camera import Camera
from ..scene.gaussians import SH_C0, Scene
from ..scene.rotations import rotation_matrices
from ..scene.sh_rotation import band
from .color_maps import colored

BLOCK = 65_536  # Gaussians that are computed at a time
SEED = 1  # of the random order
HIGHLIGHT, TINT = (1.0, 0.45, 0.05), 0.7  # display sRGB of selected Gaussians, and its share of their colour
TOP_PERCENTILE = 99.0  # values from this percentile on have the last colour of the map


@dataclass(frozen=True)
class Quads:
    """n Gaussians of a scene in random order, so that the first k of them are a random sample of the
    scene."""

    rows: np.ndarray  # (n,) int64, their rows in the scene
    means: np.ndarray  # (n, 3) float32
    geometry: np.ndarray  # (n, 3, 4) float32, rows: mean, opacity (0..1); covariance xx xy xz, 0; yy yz zz, 0


def quads(scene: Scene, count: int) -> Quads:
    """The quads of at most `count` random Gaussians. Coordinates are those of the scene."""
    rows = np.random.default_rng(SEED).permutation(scene.count)[:count]
    geometry = np.zeros((len(rows), 3, 4), np.float32)
    for start in range(0, len(rows), BLOCK):
        part = rows[start : start + BLOCK]
        scales = np.exp(scene.log_scales[part].astype(np.float64))
        axes = rotation_matrices(scene.quats[part]) * scales[:, None, :]
        S = axes @ axes.swapaxes(1, 2)
        block = geometry[start : start + BLOCK]
        block[:, 0, :3], block[:, 0, 3] = scene.means[part], activation.opacities(scene.opacity_logits[part])
        block[:, 1, :3], block[:, 2, :3] = S[:, 0], np.stack([S[:, 1, 1], S[:, 1, 2], S[:, 2, 2]], 1)
    return Quads(rows, np.ascontiguousarray(scene.means[rows]), geometry)


def painted(scene: Scene, values: list[np.ndarray | None]) -> Scene:
    """The scene in colours of a value per Gaussian, with the colour map inferno.

    values: arrays (N_i,) of its parts, one after the other. If one is None, the scene is returned unchanged.
    """
    known = [part for part in values if part is not None]
    if len(known) < len(values):
        return scene
    whole = np.concatenate(known)
    top = float(np.percentile(whole, TOP_PERCENTILE)) if len(whole) else 1.0
    return recolored(scene, colored(whole, top))


def highlighted(scene: Scene, counts: list[int], values: list[np.ndarray | None]) -> Scene:
    """The scene with marked Gaussians tinted with HIGHLIGHT. Their shading stays visible.

    counts: of the Gaussians of its parts, one after the other. values: arrays (N_i,), above 0 where marked;
    None: nothing of the part is.
    """
    parts = zip(counts, values, strict=True)
    marks = np.concatenate([np.zeros(count, bool) if part is None else part > 0 for count, part in parts])
    sh = scene.sh.copy()
    sh[marks] *= 1 - TINT
    sh[marks, 0] += (TINT * (np.array(HIGHLIGHT) - 0.5) / SH_C0).astype(np.float32)
    return replace(scene, sh=sh)


def recolored(scene: Scene, rgb: np.ndarray) -> Scene:
    """The scene with colours (N, 3), display sRGB in [0, 1], that do not depend on the view direction (SH
    degree 0)."""
    return replace(scene, sh=np.ascontiguousarray(((rgb - 0.5) / SH_C0)[:, None], np.float32))


def colors(scene: Scene, rows: np.ndarray, camera: Camera) -> np.ndarray:
    """Display sRGB colours (n, 3) float32, >= 0, of some rows of the scene as a camera sees them.

    rows: (n,) int. camera: in the coordinates of the scene. colour = max(0, 0.5 + sum of SH), as in 3DGS.
    """
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
