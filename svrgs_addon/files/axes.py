"""Axes of files whose y points up: right, up, back. Those of 3DGS, and of a Scene, are right, down, forward."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from ..scene import Scene

AXES = np.array([1, -1, -1], np.float32)  # signs of positions; of the (x, y, z) of quaternions, too
SH_SIGNS = np.array([-1, -1, 1, -1, 1, 1, -1, 1, -1, 1, -1, -1, 1, -1, 1], np.float32)  # of the coefficients of degree 1 to 3


def turned_over(scene: Scene) -> Scene:
    """The scene after half a turn around x, from the one kind of axes to the other. It is its own inverse."""
    sh = scene.sh.copy()
    with np.errstate(invalid="ignore"):  # a file may hold values that are not numbers
        sh[:, 1:] *= SH_SIGNS[: sh.shape[1] - 1, None]
        means, xyz = scene.means * AXES, scene.quats[:, 1:] * AXES
    return replace(scene, means=means, quats=np.concatenate([scene.quats[:, :1], xyz], axis=1), sh=sh)
