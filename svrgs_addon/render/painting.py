"""Scenes in other colours: of a value per Gaussian, or tinted where selected; colours that a camera sees."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from ..scene.camera import Camera
from ..scene.gaussians import SH_C0, Scene
from ..scene.sh_rotation import band
from .color_maps import colored

BLOCK = 65_536  # Gaussians that are computed at a time
HIGHLIGHT, TINT = (1.0, 0.45, 0.05), 0.7  # display sRGB of selected Gaussians, and its share of their colour
TOP_PERCENTILE = 99.0  # values from this percentile on have the last colour of the map


def painted(scene: Scene, values: list[np.ndarray | None]) -> Scene:
    """The scene in colours of a value per Gaussian, with the colour map inferno. values: arrays (N_i,) of its
    parts, one after the other. If one is None, the scene is returned unchanged."""
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
    """The scene with colours (N, 3), display sRGB in [0, 1], from everywhere the same (SH degree 0)."""
    return replace(scene, sh=np.ascontiguousarray(((rgb - 0.5) / SH_C0)[:, None], np.float32))


def colors(scene: Scene, rows: np.ndarray, camera: Camera) -> np.ndarray:
    """Display sRGB colours (n, 3) float32, max(0, 0.5 + sum of SH) as in 3DGS, of rows (n,) int of the scene
    as a camera, in its coordinates, sees them."""
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
