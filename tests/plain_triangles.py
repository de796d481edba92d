"""Meshes for tests."""

from __future__ import annotations

import numpy as np

from svrgs_addon.render.meshes import Triangles


def plain_triangles(corners: np.ndarray, colors: np.ndarray, holdout: bool = False) -> Triangles:
    """Flat triangles (M, 3, 3) without texture. colors: (M, 3) linear."""
    corners = np.ascontiguousarray(corners, np.float32)
    with np.errstate(all="ignore"):
        normal = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
        normal = np.nan_to_num(normal / np.linalg.norm(normal, axis=1, keepdims=True))
    count = len(corners)
    normals, colors = (
        np.ascontiguousarray(np.repeat(values[:, None], 3, axis=1), np.float32)
        for values in (normal, np.asarray(colors).reshape(count, 3))
    )
    return Triangles(
        corners,
        normals,
        colors,
        np.zeros((count, 3, 2), np.float32),
        np.full(count, -1, np.int32),
        np.full(count, holdout),
    )
