"""Axes of files whose y points up: right, up, back. Those of 3DGS, and of a Scene, are right, down, forward.
glTF has left, up, forward."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import replace

import numpy as np

from ..scene.affine import transformed
from ..scene.concatenate import concatenated
from ..scene.gaussians import Scene
from ..system.errors import FormatError, SceneError

# signs of positions after half a turn around x; of the (x, y, z) of quaternions, too
AXES = np.array([1, -1, -1], np.float32)
AROUND_Y = np.array([-1, 1, -1], np.float32)  # the same around y
# of the coefficients of degree 1 to 3: coordinates of which they are odd functions
FACTORS = ("y z x", "xy yz 1 xz 1", "y xyz y z x z x")


def turned_over(scene: Scene) -> Scene:
    """The scene after half a turn around x, from the one kind of axes to the other. It is its own inverse."""
    return _turned(scene, AXES)


def turned_around(scene: Scene) -> Scene:
    """The scene after half a turn around y: right becomes left, back forward. It is its own inverse."""
    return _turned(scene, AROUND_Y)


def placed(parts: Iterable[tuple[Scene, np.ndarray]], what: str) -> Scene:
    """One scene of parts in the axes of a file whose y points up, each moved by its matrix (4, 4). Raises
    FormatError (without the name of the file) if a matrix does not place `what` has it."""
    try:
        with np.errstate(over="ignore", invalid="ignore"):  # values of a damaged file
            scenes = [transformed(scene, matrix) for scene, matrix in parts]
    except SceneError as error:
        raise FormatError(f"has a {what} that cannot be placed: {error}") from None
    return turned_over(concatenated(scenes))


def _turned(scene: Scene, signs: np.ndarray) -> Scene:
    """The scene after half a turn, which gives coordinates these signs."""
    sign_of = dict(zip("xyz1", [*signs, 1], strict=True))
    sh_signs = np.array(
        [1] + [np.prod([sign_of[name] for name in factors]) for factors in " ".join(FACTORS).split()],
        np.float32,
    )
    with np.errstate(invalid="ignore"):  # a file may hold values that are not numbers
        # one long row is quicker than many of three
        sh = scene.sh.reshape(scene.count, 3 * scene.sh.shape[1]) * np.repeat(
            sh_signs[: scene.sh.shape[1]], 3
        )
        means, quats = scene.means * signs, scene.quats * np.array([1, *signs], np.float32)
    return replace(scene, means=means, quats=quats, sh=sh.reshape(scene.sh.shape))
